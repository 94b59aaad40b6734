//! Key poses as the kernels have them: planes of f32, and back.

use glam::DVec3;

use super::{
    KEY_DECAY, KEY_FIRST_PLACE, KEY_FIRST_ROTATION, KEY_PLACE, KEY_ROTATION, KEY_WORDS, KeyOptions, NO_TWIN,
    SUPERPOINT_WORDS, twin_of,
};
use crate::reference::exp;
use crate::scene::Motion;

/// `[T][22][M]` of a table that begins to learn; of its times and superpoints there are as many as the options say.
pub fn key_words(table: &Motion, options: &KeyOptions) -> Vec<f32> {
    let m = options.center.len();
    let mut key = vec![0.0_f32; table.times.len() * KEY_WORDS * m];
    for (row, (r, t)) in table.rotation.iter().zip(&table.translation).enumerate() {
        let (rotation, translation) = (DVec3::from_array(r.map(f64::from)), DVec3::from_array(t.map(f64::from)));
        let place = (exp(rotation) * options.center[row % m] + translation).as_vec3().to_array();
        let first = row / m * KEY_WORDS;
        let mut set = |word: usize, value: f32| key[(first + word) * m + row % m] = value;
        for c in 0..3 {
            [KEY_ROTATION, KEY_FIRST_ROTATION].into_iter().for_each(|word| set(word + c, r[c]));
            [KEY_PLACE, KEY_FIRST_PLACE].into_iter().for_each(|word| set(word + c, place[c]));
        }
        (0..2).for_each(|k| set(KEY_DECAY + k, 1.0));
    }
    key
}

/// `[T]`.
pub fn twin_words(times: &[f32]) -> Vec<u32> {
    (0..times.len()).map(|k| twin_of(times, k).map_or(NO_TWIN, |twin| twin as u32)).collect()
}

/// `[5][M]`.
pub fn superpoint_words(options: &KeyOptions) -> Vec<f32> {
    let m = options.center.len();
    let mut words = vec![0.0_f32; SUPERPOINT_WORDS * m];
    for (j, center) in options.center.iter().enumerate() {
        let [turn, shift] = options.scale(j);
        let row = [center.x, center.y, center.z, turn, shift];
        row.into_iter().enumerate().for_each(|(word, v)| words[word * m + j] = v as f32);
    }
    words
}

/// The table that key poses are.
pub fn table_of(key: &[f32], times: &[f32], options: &KeyOptions) -> Motion {
    let m = options.center.len();
    let mut table = Motion { times: times.to_vec(), ..Motion::default() };
    for row in 0..times.len() * m {
        let words = |word: usize| [0, 1, 2].map(|c| key[(row / m * KEY_WORDS + word + c) * m + row % m]);
        let [r, place] = [KEY_ROTATION, KEY_PLACE].map(words);
        let [rotation, at] = [r, place].map(|v| DVec3::from_array(v.map(f64::from)));
        table.rotation.push(r);
        table.translation.push((at - exp(rotation) * options.center[row % m]).as_vec3().to_array());
    }
    table
}
