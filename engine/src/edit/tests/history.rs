//! Undo and redo give back all bits, and keep little.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use super::replay::{CHANGES, SELECTIONS, bytes, cameras, edits};
use super::*;
use crate::edit::script::{Command, parse};
use crate::scene::Gaussians;
use crate::scene::synthetic::Random;

fn commands(text: &str) -> Vec<Command> {
    parse(text).unwrap()
}

fn history(scene: Scene) -> History {
    History::new(Session::new(scene, cameras(), 2.0))
}

/// Everything that a session holds. Of the Gaussians and key poses the bits, which is fast; of the rest what it prints, where each
/// number reads back as the same bits.
fn hash(session: &Session) -> u64 {
    let mut hasher = DefaultHasher::new();
    for (name, shape, values) in session.scene.gaussians.arrays() {
        (name, shape, bytemuck::cast_slice::<f32, u32>(values)).hash(&mut hasher);
    }
    let mut rest = session.clone();
    rest.scene.gaussians = Gaussians::default();
    if let Some(table) = rest.scene.deformation.table_mut().map(std::mem::take) {
        for poses in [&table.rotation, &table.translation] {
            bytemuck::cast_slice::<[f32; 3], u32>(poses).hash(&mut hasher);
        }
        bytemuck::cast_slice::<f32, u32>(&table.times).hash(&mut hasher);
    }
    format!("{rest:?}").hash(&mut hasher);
    hasher.finish()
}

/// Commands of which one is picked at random; `merge` adds what a file holds.
fn random_commands(random: &mut Random, merge: &str, history: &History) -> Vec<Command> {
    // Beyond this size a copy would make the test slow.
    let (n, keys) = (history.session().scene.gaussians.len(), history.session().scene.deformation.key_times().len());
    let text = match random.below(20) {
        0 if n < 120 => merge,
        1..8 => SELECTIONS[random.below(SELECTIONS.len())],
        _ => CHANGES[random.below(CHANGES.len())],
    };
    let grows = ["duplicate", "part", "during", "freeze", "time", "superpoint 2"].iter().any(|w| text.contains(w));
    let text = if grows && (n > 200 || keys > 60) { "select gaussians 0-9; delete" } else { text };
    let text = if n < 40 { merge } else { text };
    commands(text)
}

#[test]
fn a_thousand_random_operations_are_undone_and_redone_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("other.safetensors");
    crate::file::model::write(&other, &moving_scene(40, 3, 4, 9, false)).unwrap();
    let merge = format!("merge \"{}\" at 0.3,0,0 scale 0.8 time 0.1+0.5t", other.display());
    let mut random = Random::new(5);
    let mut history = history(soft_scene());
    let mut hashes = vec![hash(history.session())];
    let (mut done, mut undone, mut redone, mut refused) = (0, 0, 0, 0);
    while done + undone + redone < 1000 {
        match random.below(10) {
            0..4 => {
                let group: Vec<Command> =
                    (0..1 + random.below(2)).flat_map(|_| random_commands(&mut random, &merge, &history)).collect();
                let at = history.done().len();
                match history.run(&group) {
                    Ok(()) => {
                        done += 1;
                        hashes.truncate(at + 1);
                        hashes.push(hash(history.session()));
                    }
                    Err(_) => {
                        refused += 1;
                        assert_eq!(hash(history.session()), hashes[at], "a group that fails changes nothing");
                    }
                }
            }
            4..7 => undone += usize::from(history.undo().is_some()),
            _ => redone += usize::from(history.redo().is_some()),
        }
        assert_eq!(hash(history.session()), hashes[history.done().len()], "after {done} + {undone} + {redone}");
    }
    println!("{done} done, {undone} undone, {redone} redone, {refused} refused, {} bytes", history.bytes());
    assert!(done > 300 && undone > 150 && redone > 100, "{done} {undone} {redone}");
    // The list makes the same model, and the way back and forth all of them.
    let mut again = Session::new(soft_scene(), cameras(), 2.0);
    for edit in edits(history.steps()) {
        again.apply(&commands(&edit)[0]).unwrap();
    }
    assert!(bytes(&again.finished()) == bytes(&history.session().finished()), "the list makes another model");
    while history.undo().is_some() {
        assert_eq!(hash(history.session()), hashes[history.done().len()]);
    }
    assert_eq!(history.session().scene, soft_scene());
    while history.redo().is_some() {
        assert_eq!(hash(history.session()), hashes[history.done().len()]);
    }
}

#[test]
fn the_past_takes_what_was_changed() {
    let mut history = history(random_scene(20_000, 3, 1));
    let scene = 20_000 * (3 + 3 + 4 + 1 + 48) * 4;
    let mut cost = |text: &str| {
        let before = history.bytes();
        history.run(&commands(text)).unwrap();
        history.bytes() - before
    };
    // Some numbers of a row (59 of them a whole one), where it was and what was selected.
    let (masks, row) = (3 * 20_000 / 8, 59 * 4 + 12);
    for (text, most) in [
        ("select gaussians 100-199", masks),
        ("move 1,0,0", 100 * 16 + masks),
        ("recolor gain 0.5", 100 * 200 + masks),
        ("duplicate", masks + 64 * 20),
        ("delete", 100 * row + masks),
        ("select gaussians 0,7,900-949", masks),
        ("delete", 52 * row + masks),
    ] {
        let found = cost(text);
        assert!(found <= most && most < scene / 20, "{text}: {found} bytes, more than {most}");
    }
}

#[test]
fn hidden_and_locked_gaussians_stay_as_they_are() {
    let mut history = history(scene());
    let selected = |history: &History| history.session().selected().unwrap().iter().filter(|m| **m).count();
    let mut run = |text: &str| {
        history.run(&commands(text)).unwrap();
        selected(&history)
    };
    assert_eq!(run("select gaussians 0-9; name some; hide"), 0);
    assert_eq!(run("select all"), 290);
    assert_eq!(run("show; select all"), 300);
    assert_eq!(run("lock named some; invert; add all"), 290);
    assert_eq!(run("select gaussians 5-14; invert; invert"), 5);
    assert_eq!(run("isolate; unlock; select all"), 5);
    // All others go, but not what cannot be touched.
    assert_eq!(run("show; select gaussians 20-29; lock; select gaussians 0-4; keep"), 5);
    assert_eq!(history.session().scene.gaussians.len(), 15);
    assert_eq!(history.session().locked().unwrap().iter().filter(|m| **m).count(), 10);
    assert!(history.run(&commands("hide named none")).unwrap_err().to_string().contains("some"));
}

/// What is no row: networks that a move takes away, a degree that a merge raises, whether there is a table at all.
#[test]
fn networks_degrees_and_tables_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("other.safetensors");
    crate::file::model::write(&other, &moving_scene(40, 3, 4, 9, false)).unwrap();
    let merge = format!("merge \"{}\"", other.display());
    let flat = random_scene(50, 2, 0);
    assert!(flat.gaussians.sh_degree < 3);
    for (scene, text) in [
        (moving_scene(60, 4, 5, 3, true), "select gaussians 0-9; move 1,0,0"),
        (moving_scene(60, 4, 5, 3, true), merge.as_str()),
        (flat.clone(), merge.as_str()),
        (flat, "select gaussians 0-9; move 0,1,0 during 0..0.5"),
    ] {
        let mut history = history(scene.clone());
        history.run(&commands(text)).unwrap();
        let (changed, bits) = (history.session().scene.clone(), hash(history.session()));
        assert!(changed.deformation != scene.deformation || changed.gaussians.sh_degree != scene.gaussians.sh_degree);
        history.undo();
        assert!(history.session().scene == scene, "{text}");
        history.redo();
        assert!(history.session().scene == changed && hash(history.session()) == bits, "{text}");
    }
}
