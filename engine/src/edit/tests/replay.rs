//! Lists of edits make the same model again; scripts of any kind end in a model or in an error with a place.

use std::path::Path;

use proptest::prelude::*;

use super::*;
use crate::edit::script::{EditList, ListedEdit, parse};
use crate::file::model;
use crate::scene::synthetic::Random;

pub(super) const SELECTIONS: [&str; 15] = [
    "select all",
    "select superpoints 1-3",
    "select gaussians 5,20-90",
    "select sphere 0.1,0,0.2 0.7 time 0.4",
    "add box -1,-1,-1 0,0.5,1",
    "subtract opacity below 0.4",
    "intersect size 0.001..0.2",
    "select click 48,36 view 0 similar 40px",
    "select click 50%,50% view 0",
    "select rect 30,20,60,50 view 1 time 0.3 depth 0.4",
    "add color #aa5533 within 0.5",
    "select superpoints 0 similar 0.2",
    "select floaters 3.2",
    "select lasso 30,20 60,25 50,60 view 1 time 0.6 through",
    "subtract named kept",
];
pub(super) const CHANGES: [&str; 25] = [
    "invert",
    "grow 0.05",
    "move 0.1,-0.05,0",
    "move 0,0.1,0 frame part time 0.3",
    "rotate z 25 pivot center",
    "rotate 1,1,0 -70 pivot 0.1,0,0 frame part",
    "rotate y 10 frame superpoint 2",
    "scale 1.1",
    "scale 0.9 frame part time 0.7",
    "move 0,0,0.1 during 0.2..0.4 ease 0.1",
    "rotate x 40 during 0.5..0.5",
    "recolor tint #ff8800 gain 0.9 offset 0.01,0,0.02",
    "recolor matrix 0,1,0,0,0,1,1,0,0",
    "freeze 0.5",
    "time shift 0.1",
    "time stretch 1.5",
    "time reverse",
    "name kept",
    "hide",
    "isolate",
    "show",
    "lock named kept",
    "unlock",
    "delete",
    "duplicate",
];

pub(super) fn cameras() -> Vec<Camera> {
    vec![camera(), Camera { time: 0.25, position: DVec3::new(0.0, 1.0, -3.0), ..camera() }]
}

fn session(cameras: Vec<Camera>) -> Session {
    Session::new(soft_scene(), cameras, 2.0)
}

/// The file's bytes.
pub(super) fn bytes(scene: &Scene) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.safetensors");
    model::write(&path, scene).unwrap();
    std::fs::read(path).unwrap()
}

/// Commands as a written list has them.
pub(super) fn edits<'a>(steps: impl Iterator<Item = &'a Step>) -> Vec<String> {
    let listed = |step: &Step| ListedEdit { command: step.command.clone(), selected: step.selected, touched: 0 };
    let text = EditList::new(2.0, steps.map(listed).collect(), &cameras()).to_text().unwrap();
    let list = EditList::parse(&text, Path::new("edits.toml")).unwrap();
    list.edits.into_iter().map(|edit| edit.command).collect()
}

/// A click at a share of the image takes what the pixel there takes.
#[test]
fn clicks_in_percent_are_clicks_at_pixels() {
    let selected = |text: &str| {
        let mut session = session(cameras());
        session.apply(&parse(text).unwrap()[0]).map(|step| step.selected)
    };
    let [width, height] = [camera().width, camera().height].map(f64::from);
    let mut found = Vec::new();
    for percent in [[50.0, 50.0], [25.0, 50.0], [55.0, 40.0]] {
        let [x, y] = [0.01 * percent[0] * width, 0.01 * percent[1] * height];
        let pixels = selected(&format!("select click {x},{y} view 0"));
        let share = selected(&format!("select click {}%,{}% view 0", percent[0], percent[1]));
        assert_eq!(share.as_ref().ok(), pixels.as_ref().ok(), "{percent:?}");
        found.extend(share.ok());
    }
    assert!(found.iter().any(|n| *n > 0), "{found:?}");
    for wrong in ["50%", "50%,", "%,1", "50 %,50%", "1,2,3%"] {
        assert!(parse(&format!("select click {wrong} view 0")).is_err(), "{wrong}");
    }
}

/// Random edits, a few hundred altogether, and the same from the written list.
#[test]
fn a_list_makes_the_same_model_again() {
    let (mut random, mut applied) = (Random::new(21), 0);
    for _ in 0..24 {
        let mut first = session(cameras());
        let mut edits = Vec::new();
        for k in 0..20 {
            let of = |list: &[&'static str], random: &mut Random| list[random.below(list.len())];
            let text = if k % 3 == 0 { of(&SELECTIONS, &mut random) } else { of(&CHANGES, &mut random) };
            let command = parse(text).unwrap().swap_remove(0);
            // What fails, for lack of pixels or of Gaussians, is not in the list.
            let before = first.clone();
            match first.apply(&command) {
                Ok(step) if first.scene.gaussians.len() < 2000 && first.scene.deformation.key_times().len() < 400 => {
                    edits.push(ListedEdit { command: step.command, selected: step.selected, touched: 0 });
                }
                _ => first = before,
            }
        }
        applied += edits.len();
        let text = EditList::new(2.0, edits, first.cameras_used()).to_text().unwrap();
        let list = EditList::parse(&text, Path::new("edits.toml")).unwrap();
        let mut again = session(list.cameras());
        for edit in &list.edits {
            again.apply(&parse(&edit.command).unwrap()[0]).unwrap();
        }
        assert!(bytes(&first.scene) == bytes(&again.scene), "{text}");
    }
    println!("{applied} edits");
    assert!(applied > 300, "{applied}");
}

#[test]
fn mistakes_say_line_and_column() {
    for (script, line, column, found, expected) in [
        ("select al", 1, 8, "`al`", "superpoints"),
        ("\n  move 0,1\n", 2, 8, "`0,1`", "x,y,z"),
        ("select all; rotate z", 1, 21, "the end of the command", "degrees"),
        ("select all;rotate z 3 pivot middle", 1, 29, "`middle`", "center"),
        ("delete all", 1, 8, "`all`", "the end of the command"),
        ("merge \"a b", 1, 7, "a quote that does not end", "second"),
        ("frobnicate", 1, 1, "`frobnicate`", "select"),
        ("select sphere 0,0,0 -1", 1, 21, "`-1`", "radius above 0"),
        ("scale 0", 1, 7, "`0`", "above 0"),
        ("move nan,0,0", 1, 6, "`nan,0,0`", "x,y,z"),
        ("time loop 0.5..0.5", 1, 11, "`0.5..0.5`", "0..0.5"),
        ("move 0,1,0 frame part during 0..1", 1, 23, "`during`", "world"),
        ("move 0,1,0 during 0..1 frame part", 1, 34, "the end", "world"),
        ("recolor tint #ff88", 1, 13, "the end of the command", "#ff8800"),
        ("recolor", 1, 8, "the end of the command", "tint"),
        ("select lasso 1,1 2,2 view 0", 1, 22, "`view`", "three pixels"),
        ("hide some", 1, 6, "`some`", "the end of the command"),
        ("camera eye 1,2,3", 1, 17, "the end of the command", "target"),
        ("merge a.ply time 0.25+0t", 1, 18, "`0.25+0t`", "0.25+0.5t"),
    ] {
        let error = parse(script).unwrap_err();
        assert_eq!((error.place.line, error.place.column), (line, column), "{script}: {error:?}");
        assert!(error.found.contains(found) && error.expected.contains(expected), "{script}: {error:?}");
    }
}

#[test]
fn words_mean_what_they_say() {
    use crate::edit::script::{Action, Retime};
    let actions = |text: &str| -> Vec<Action> { parse(text).unwrap().into_iter().map(|c| c.action).collect() };
    assert_eq!(actions("# all\nfreeze 0.5 # then\ntime reverse"), actions("freeze 0.5;time reverse"));
    assert_eq!(actions("time shift 1e-1"), [Action::Retime(Retime::Shift(0.1))]);
    for (text, expected) in [
        ("0.25+0.5t", [0.25, 0.5]),
        ("t", [0.0, 1.0]),
        ("1-t", [1.0, -1.0]),
        ("-2t", [0.0, -2.0]),
        ("1e-1-2*t", [0.1, -2.0]),
    ] {
        let Action::Merge { time, file, .. } = actions(&format!("merge \"a #1; b.ply\" time {text}")).swap_remove(0)
        else {
            panic!("no merge")
        };
        assert_eq!((time, file.as_str()), (expected, "a #1; b.ply"), "{text}");
    }
    let text = "select click 400,310 view 3 time 0.4 similar 1.5px";
    assert_eq!(parse(&format!("  {text}  ")).unwrap()[0].text, text);
    for wrong in ["format = 1", "", "format = \"spgs edits\"\nversion = 2\nbound_px = 1.0\n", "[[edit]]\ncommand = 3\n"]
    {
        let error = EditList::parse(wrong, Path::new("e.toml")).unwrap_err();
        assert!(error.to_string().contains("line ") && error.exit_code() == 3, "{error}");
    }
}

fn words() -> impl Strategy<Value = String> {
    let known: Vec<&'static str> = SELECTIONS.iter().chain(&CHANGES).flat_map(|text| text.split(' ')).collect();
    let word = prop_oneof![
        proptest::sample::select(known).prop_map(str::to_owned),
        "[-0-9.,e]{1,9}",
        "[a-z]{1,6}",
        Just("\n".to_owned()),
        Just(";".to_owned()),
        Just("#".to_owned()),
        Just("\"".to_owned()),
        Just("merge x.ply at 1,0,0".to_owned()),
        Just("camera eye 0,0,-3 target 0,0,0".to_owned()),
    ];
    proptest::collection::vec(word, 0..24).prop_map(|words| words.join(" "))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]

    /// No text makes the parser panic, and each error names a place in the text.
    #[test]
    fn any_script_is_read_or_rejected_at_a_place(text in prop_oneof![words(), any::<String>(), "\\PC*"]) {
        match parse(&text) {
            Ok(commands) => for command in commands {
                let again = parse(&command.text).unwrap();
                prop_assert_eq!(again.len(), 1);
                prop_assert_eq!(format!("{:?}", &again[0].action), format!("{:?}", &command.action));
            },
            Err(error) => {
                let line = text.lines().nth(error.place.line.wrapping_sub(1)).unwrap_or("");
                prop_assert!(error.place.line >= 1 && error.place.column >= 1);
                prop_assert!(error.place.column <= line.chars().count() + 1, "{:?} in {:?}", error, text);
                prop_assert!(!error.found.is_empty() && !error.expected.is_empty());
            }
        }
    }

    /// No command that can be read makes a session panic.
    #[test]
    fn any_list_is_read_or_rejected(text in any::<String>()) {
        let _ = EditList::parse(&text, Path::new("e.toml"));
    }
}
