//! Scripts of all kinds, most of them wrong: each is carried out or rejected with a place, and what fails changes nothing.

use rayon::prelude::*;

use super::replay::{CHANGES, SELECTIONS, cameras};
use super::*;
use crate::edit::script::{Action, Place, parse};
use crate::scene::synthetic::{Random, random_blend};

/// Numbers and other words that no command expects everywhere.
const ODD: [&str; 34] = [
    "nan",
    "NaN,0,0",
    "inf",
    "-inf,1,1",
    "1e308",
    "-1e308,1e308,0",
    "1e-320",
    "0",
    "-0",
    "0,0,0",
    "99999999999999999999",
    "-1",
    "3-1",
    "0-4294967296",
    "0.5..0.1",
    "0..1e-9",
    "1e400",
    "..",
    ",",
    ",,",
    "#",
    "#12345",
    "#ff88zz",
    "\"",
    "\"a b\"",
    "px",
    "1.5px",
    "é",
    "日本語",
    "\u{202e}",
    "\u{0}",
    "\t",
    ";",
    "\n",
];
const OTHERS: [&str; 13] = [
    "camera eye 0,0,-4 target 0,0,0 up 0,1,0 fov 45 size 64,48",
    "select click 32,24",
    "select click 50%,40%",
    "select rect 0,0,64,48 through",
    "scale 2,1,1",
    "scale 1.5 pivot origin",
    "merge nothing.ply at 1,0,0 rotate z 90 scale 2 time 0.25+0.5t",
    "time loop 0..0.5",
    "keep",
    "lock",
    "hide named kept",
    "select none",
    "select all # a comment",
];

fn line(random: &mut Random) -> &'static str {
    match random.below(3) {
        0 => SELECTIONS[random.below(SELECTIONS.len())],
        1 => CHANGES[random.below(CHANGES.len())],
        _ => OTHERS[random.below(OTHERS.len())],
    }
}

fn word(random: &mut Random) -> String {
    if random.below(2) == 0 {
        return ODD[random.below(ODD.len())].to_owned();
    }
    let words: Vec<&str> = line(random).split(' ').collect();
    words[random.below(words.len())].to_owned()
}

/// A line with a word or a character that is another, missing, twice or new.
fn mutated(random: &mut Random) -> String {
    let text = line(random);
    if random.below(2) == 0 {
        let mut words: Vec<String> = text.split(' ').map(str::to_owned).collect();
        let at = random.below(words.len());
        match random.below(4) {
            0 => drop(words.remove(at)),
            1 => words.insert(at, word(random)),
            2 => words.truncate(at),
            _ => words[at] = word(random),
        }
        return words.join(" ");
    }
    let mut letters: Vec<char> = text.chars().collect();
    let at = random.below(letters.len());
    let letter = char::from_u32(random.below(0x300) as u32).unwrap_or('?');
    match random.below(3) {
        0 => drop(letters.remove(at)),
        1 => letters.insert(at, letter),
        _ => letters[at] = letter,
    }
    letters.into_iter().collect()
}

/// A script of one to four lines.
fn script(seed: u64) -> String {
    let mut random = Random::new(seed);
    let count = 1 + random.below(4);
    let mut lines: Vec<String> = Vec::new();
    // Most begin with a selection, so that more is carried out than its lack.
    if random.below(4) > 0 {
        lines.push(SELECTIONS[random.below(4)].into());
    }
    for _ in 0..count {
        lines.push(match random.below(8) {
            0..3 => line(&mut random).into(),
            3..6 => mutated(&mut random),
            6 => (0..1 + random.below(6)).map(|_| word(&mut random) + " ").collect(),
            _ => {
                let bytes: Vec<u8> = (0..random.below(40)).map(|_| random.below(256) as u8).collect();
                String::from_utf8_lossy(&bytes).into_owned()
            }
        });
    }
    lines.join(["\n", "; ", "\r\n"][random.below(3)])
}

/// 40 Gaussians with soft superpoints.
fn small() -> Scene {
    let mut scene = moving_scene(40, 6, 4, 2, false);
    let blend = random_blend(40, 6, 2, 5);
    let s = scene.deformation.superpoint_deformation_mut().unwrap();
    (s.superpoints.of_gaussian, s.blend) = (blend.of_gaussian(), Some(blend));
    scene
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Done,
    Failed,
    Rejected,
    Large,
}

fn is_within(Place { line, column }: Place, text: &str) -> bool {
    let lines: Vec<&str> = text.split('\n').collect();
    (1..=lines.len()).contains(&line) && (1..=lines[line - 1].chars().count() + 1).contains(&column)
}

fn try_script(seed: u64, scene: &Scene) -> End {
    let text = script(seed);
    let commands = match parse(&text) {
        Ok(commands) => commands,
        Err(error) => {
            assert!(is_within(error.place, &text), "{seed}: {error:?} in {text:?}");
            assert!(!error.found.is_empty() && !error.expected.is_empty(), "{seed}: {error:?}");
            return End::Rejected;
        }
    };
    assert!(commands.iter().all(|c| is_within(c.place, &text)), "{seed}: {text:?}");
    // Images of millions of pixels would only take long.
    let is_large = |c: &Camera| c.width > 200 || c.height > 200;
    if commands.iter().any(|c| matches!(&c.action, Action::Camera(camera) if is_large(camera))) {
        return End::Large;
    }
    let mut history = History::new(Session::new(scene.clone(), cameras(), 2.0));
    let end = match history.run(&commands) {
        Ok(()) => End::Done,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            End::Failed
        }
    };
    history.undo();
    assert!(history.session().scene == *scene, "{seed}: the scene is another after {text:?}");
    assert!(history.session().selected().is_none(), "{seed}: a selection stays of {text:?}");
    end
}

fn try_scripts(count: u64) {
    let scene = small();
    let ends: Vec<End> = (0..count).into_par_iter().map(|seed| try_script(seed, &scene)).collect();
    let of = |end: End| ends.iter().filter(|e| **e == end).count();
    let (done, failed, rejected) = (of(End::Done), of(End::Failed), of(End::Rejected));
    println!("{count} scripts: {done} carried out, {failed} failed, {rejected} rejected, {} too large", of(End::Large));
    let least = count as usize / 20;
    assert!(done > least && failed > least && rejected > least, "{done} {failed} {rejected}");
}

#[test]
fn scripts_of_all_kinds_are_carried_out_or_rejected_with_a_place() {
    try_scripts(5_000);
}

#[test]
#[ignore = "the same, longer: cargo test --release -p spgs-engine --lib hundred_thousand_scripts -- --ignored --nocapture"]
fn a_hundred_thousand_scripts_are_carried_out_or_rejected_with_a_place() {
    try_scripts(100_000);
}
