//! The tree of `tools`: folders import downwards only, and no files import each other in a circle.

use std::collections::BTreeMap;

use super::paths::{self, Imports, Module};
use super::root;

/// Folders of `tools/src`, lowest first; those of one line may not import each other.
const FOLDERS: &[&[&str]] = &[&["manual"], &["report"], &["cli"], &["bench", "viewer"], &["command", "dev"]];

/// Imports that do not point downwards.
fn breaches(imports: &Imports) -> Vec<String> {
    let rank = |m: &Module| {
        let folder = m.first()?;
        FOLDERS.iter().position(|row| row.contains(&folder.as_str()))
    };
    let mut wrong = Vec::new();
    for (from, to) in imports.iter().filter(|(from, _)| !from.is_empty()) {
        let Some(own) = rank(from) else {
            wrong.push(format!("`{}` has no place in FOLDERS", from.join("::")));
            continue;
        };
        for target in to.iter().filter(|t| t.first() != from.first()) {
            if rank(target).is_none_or(|r| r >= own) {
                wrong.push(format!("`{}` imports `{}`, which is not below it", from.join("::"), target.join("::")));
            }
        }
    }
    wrong
}

#[test]
fn folders_of_tools_import_downwards() {
    let imports = paths::imports(&root().join("tools/src"));
    assert!(imports.len() > 100, "found only {} files", imports.len());
    let wrong = breaches(&imports);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn files_of_tools_import_each_other_in_no_circle() {
    let circles = paths::circles(&paths::imports(&root().join("tools/src")));
    let lines: Vec<String> = circles.iter().map(|c| c.join(", ")).collect();
    assert!(lines.is_empty(), "files that import each other:\n{}", lines.join("\n"));
}

/// The imports of sources in memory.
fn sources(all: &[(&str, &str)]) -> Imports {
    let module = |path: &str| path.split("::").filter(|p| !p.is_empty()).map(str::to_owned).collect::<Module>();
    paths::of(&all.iter().map(|(path, text)| (module(path), (*text).to_owned())).collect::<BTreeMap<_, _>>())
}

#[test]
fn breaches_and_circles_are_seen_however_they_are_written() {
    let upwards = [
        "use crate::command::train;",
        "use crate::{report::page, command::train::run};",
        "fn f() { crate::command::train::run(); }",
        "use super::super::command::train::run;",
        "mod inner { use super::super::super::command; }",
    ];
    for text in upwards {
        let imports =
            sources(&[("", ""), ("cli::args", text), ("report", ""), ("command", ""), ("command::train", "")]);
        assert_eq!(breaches(&imports).len(), 1, "{text}");
    }
    for text in ["// use crate::command;", "let s = \"crate::command\";", "use engine::command;", "use crate::report;"]
    {
        let imports =
            sources(&[("", ""), ("cli::args", text), ("report", ""), ("command", ""), ("command::train", "")]);
        assert!(breaches(&imports).is_empty(), "{text}");
    }
    let circles = |parent: &str, child: &str, other: &str| {
        paths::circles(&sources(&[("", ""), ("a", parent), ("a::b", child), ("a::c", other)]))
    };
    assert_eq!(circles("mod b; fn f() { b::g(); }", "use super::F;", ""), [["a", "a::b"]]);
    assert_eq!(circles("mod b; pub use b::{G as H};", "use crate::a::F;", ""), [["a", "a::b"]]);
    assert_eq!(circles("mod b;", "use super::c;", "fn f() -> super::b::G {}"), [["a::b", "a::c"]]);
    assert_eq!(circles("mod b; use b::G;", "use super::{c::{self, F}, c};", "use crate::x;"), [[""; 0]; 0]);
    assert_eq!(circles("mod b;", "mod tests { use super::super::F; }", ""), [["a", "a::b"]]);
}
