//! Which file of a crate names which: every path of a source file, through `use`, `crate::`, `self::`, `super::`, the name of a
//! child module or its declaration, resolved to the file that it leads to.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::text::{code_only, tokens};
use super::{files, module_path};

/// `a::b::c`.
pub(crate) type Module = Vec<String>;
/// The modules that a module imports from.
pub(crate) type Imports = BTreeMap<Module, BTreeSet<Module>>;

/// The imports of every file below a folder but those of its programs.
pub(crate) fn imports(source: &Path) -> Imports {
    let read = |f: &std::path::PathBuf| (module_path(source, f), std::fs::read_to_string(f).unwrap());
    of(&files(source, "rs").iter().filter(|f| !f.starts_with(source.join("bin"))).map(read).collect())
}

/// The same of sources in memory.
pub(crate) fn of(sources: &BTreeMap<Module, String>) -> Imports {
    let modules: BTreeSet<Module> = sources.keys().cloned().collect();
    sources.iter().map(|(own, text)| (own.clone(), targets(own, &tokens(&code_only(text)), &modules))).collect()
}

/// The files that a file names.
fn targets(own: &Module, t: &[String], modules: &BTreeSet<Module>) -> BTreeSet<Module> {
    let is = |i: usize, s: &str| t.get(i).is_some_and(|x| x == s);
    let (mut found, mut here, mut inline, mut depth, mut i) =
        (BTreeSet::new(), own.clone(), Vec::new(), 0_usize, 0_usize);
    while i < t.len() {
        let mut paths = Vec::new();
        match t[i].as_str() {
            "{" => {
                depth += 1;
                if i >= 2 && is(i - 2, "mod") {
                    here.push(t[i - 1].clone());
                    inline.push(depth);
                }
            }
            "}" => {
                if inline.last() == Some(&depth) {
                    inline.pop();
                    here.pop();
                }
                depth = depth.saturating_sub(1);
            }
            "mod" if is(i + 2, ";") => paths.push(vec![t[i + 1].clone()]),
            // Not the bounds of `impl Trait + use<'a>`.
            "use" if !is(i + 1, "<") => i = tree(t, i + 1, &mut Vec::new(), &mut paths),
            word if is(i + 1, "::") && is_name(word) && !(i > 0 && is(i - 1, "::")) => {
                let mut path = vec![word.to_owned()];
                while is(i + 1, "::") && t.get(i + 2).is_some_and(|w| is_name(w)) {
                    path.push(t[i + 2].clone());
                    i += 2;
                }
                paths.push(path);
            }
            _ => {}
        }
        found.extend(paths.iter().filter_map(|p| resolve(&here, p, modules)).filter(|m| m != own));
        i += 1;
    }
    found
}

fn is_name(word: &str) -> bool {
    word.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// The paths of a `use` tree at `i`; where it ends.
fn tree(t: &[String], mut i: usize, before: &mut Module, paths: &mut Vec<Module>) -> usize {
    let length = before.len();
    while let Some(token) = t.get(i) {
        match token.as_str() {
            "{" => {
                i += 1;
                while t.get(i).is_some_and(|x| x != "}" && x != ";") {
                    i = tree(t, i, before, paths);
                    i += usize::from(t.get(i).is_some_and(|x| x == ","));
                }
                before.truncate(length);
                return i + 1;
            }
            "," | "}" | ";" => break,
            "as" => i += 1,
            "::" | "*" => {}
            name => before.push(name.to_owned()),
        }
        i += 1;
    }
    paths.push(before.clone());
    before.truncate(length);
    i
}

/// The file that a path leads to, if it is one of this crate.
fn resolve(here: &Module, path: &[String], modules: &BTreeSet<Module>) -> Option<Module> {
    let mut at = here.clone();
    let rest = match path.first()?.as_str() {
        "crate" => {
            at.clear();
            &path[1..]
        }
        "self" => &path[1..],
        "super" => {
            let levels = path.iter().take_while(|p| *p == "super").count();
            at.truncate(at.len().checked_sub(levels)?);
            &path[levels..]
        }
        child => {
            at.push(child.to_owned());
            return modules.contains(&at).then(|| longest(at, &path[1..], modules));
        }
    };
    while !modules.contains(&at) {
        at.pop()?;
    }
    Some(longest(at, rest, modules))
}

fn longest(mut at: Module, rest: &[String], modules: &BTreeSet<Module>) -> Module {
    for name in rest {
        at.push(name.clone());
        if !modules.contains(&at) {
            at.pop();
            break;
        }
    }
    at
}

/// Groups of modules that import each other, on whatever way.
pub(crate) fn circles(imports: &Imports) -> Vec<Vec<String>> {
    let reach: BTreeMap<&Module, BTreeSet<&Module>> = imports.keys().map(|m| (m, reached(m, imports))).collect();
    let (mut found, mut seen) = (Vec::new(), BTreeSet::new());
    for (module, to) in &reach {
        if to.contains(module) && seen.insert(*module) {
            let all: Vec<&Module> = to.iter().copied().filter(|m| reach[m].contains(module)).collect();
            seen.extend(&all);
            found.push(all.iter().map(|m| m.join("::")).collect());
        }
    }
    found
}

fn reached<'a>(from: &Module, imports: &'a Imports) -> BTreeSet<&'a Module> {
    let mut found: BTreeSet<&Module> = BTreeSet::new();
    let mut next: Vec<&Module> = imports[from].iter().collect();
    while let Some(module) = next.pop() {
        if found.insert(module) {
            next.extend(&imports[module]);
        }
    }
    found
}
