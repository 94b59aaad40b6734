//! `spgs help`: the commands and topics, the options of a command, or a page of the manual.

mod page;

use clap::CommandFactory as _;
use engine::error::{Error, Result};

use crate::cli::args::{Cli, HelpArgs};
use crate::cli::output;
use crate::manual;

/// Prints what `args` asks for.
///
/// # Errors
/// `Usage` for what is neither a command nor a topic, with all topics.
pub fn run(args: &HelpArgs) -> Result<()> {
    let mut command = Cli::command();
    command.build();
    let Some((first, modes)) = args.about.split_first() else {
        // A reader that went away is no error, as in `output::line`.
        let _ = command.print_help();
        return Ok(());
    };
    let Some(mut found) = command.find_subcommand_mut(first) else {
        output::line(text(first)?.trim_end());
        return Ok(());
    };
    for mode in modes {
        found = found.find_subcommand_mut(mode).ok_or_else(|| {
            Error::usage("help", format!("`{first} {mode}`"), format!("a mode that `spgs help {first}` lists"))
        })?;
    }
    let _ = found.print_long_help();
    Ok(())
}

/// A page of the manual for the terminal.
///
/// # Errors
/// `Usage` for an unknown topic.
pub fn text(topic: &str) -> Result<String> {
    let found = manual::pages().find(|p| p.topic == topic);
    found.map(|p| page::plain(p.text)).ok_or_else(|| {
        let topics: Vec<&str> = manual::pages().map(|p| p.topic).collect();
        Error::usage("help", format!("`{topic}`"), format!("a command or one of these topics: {}", topics.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use std::collections::BTreeSet;
    use std::path::{Path, PathBuf};

    use super::*;

    fn root() -> &'static Path {
        Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
    }

    /// The Markdown files of the repository that people read.
    fn documents() -> Vec<PathBuf> {
        let mut all = vec![root().join("README.md"), root().join("CONTRIBUTING.md"), root().join("CHANGELOG.md")];
        for folder in ["engine/docs", "tools/docs"] {
            let entries = std::fs::read_dir(root().join(folder)).unwrap().map(|e| e.unwrap().path());
            all.extend(entries.filter(|p| p.extension().is_some_and(|e| e == "md")));
        }
        all
    }

    /// Text outside fenced code.
    fn prose(text: &str) -> String {
        text.split("```").step_by(2).collect()
    }

    /// What inline links, images and link definitions point at.
    fn targets(text: &str) -> Vec<String> {
        let text = prose(text);
        let inline = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        let sources = text.split("src=\"").skip(1).filter_map(|rest| rest.split('"').next());
        let defined = text.lines().filter_map(|l| l.strip_prefix('[')?.split_once("]: ").map(|(_, target)| target));
        inline.chain(sources).chain(defined).map(str::to_owned).collect()
    }

    #[test]
    fn every_page_is_a_topic() {
        let files: BTreeSet<String> = documents()
            .iter()
            .filter(|p| p.parent().unwrap().ends_with("docs"))
            .map(|p| p.file_stem().unwrap().to_string_lossy().into_owned())
            .collect();
        let topics: BTreeSet<String> = manual::pages().map(|p| p.topic.to_owned()).collect();
        assert_eq!(files, topics);
        assert_eq!(topics.len(), manual::pages().count(), "a topic has two pages");
        let list = crate::cli::args::topics();
        for page in manual::pages() {
            assert!(page.text.starts_with("# ") && !page.title().is_empty(), "{}", page.topic);
            assert!(list.contains(page.topic) && list.contains(page.title()), "{list}");
            let text = text(page.topic).unwrap();
            assert!(text.contains(page.title()) && !text.contains("```") && !text.contains("]("), "{text}");
            assert!(Cli::command().find_subcommand(page.topic).is_none(), "{} is a command too", page.topic);
        }
    }

    #[test]
    fn an_unknown_topic_is_a_usage_error_that_names_the_topics() {
        let error = text("nonsense").unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(manual::pages().all(|p| error.to_string().contains(p.topic)), "{error}");
    }

    #[test]
    fn the_readme_is_short() {
        for (file, most) in [("README.md", 150), ("CONTRIBUTING.md", 80)] {
            let lines = std::fs::read_to_string(root().join(file)).unwrap().lines().count();
            assert!(lines <= most, "{file}: {lines} lines, at most {most} expected");
        }
    }

    #[test]
    fn relative_links_exist() {
        let mut checked = 0;
        for document in documents() {
            let text = std::fs::read_to_string(&document).unwrap();
            let relative = |t: &&String| !t.contains("://") && !t.starts_with('#');
            for target in targets(&text).iter().filter(relative) {
                let path = document.parent().unwrap().join(target.split('#').next().unwrap());
                assert!(path.exists(), "{} links to {target}, which does not exist", document.display());
                checked += 1;
            }
        }
        assert!(checked > 30, "{checked}");
    }

    #[test]
    fn links_of_pages_are_defined_for_rustdoc_and_for_the_web() {
        for (folder, source) in [("engine", "engine/src/manual.rs"), ("tools", "tools/src/manual.rs")] {
            let source = std::fs::read_to_string(root().join(source)).unwrap();
            let pages = if folder == "engine" { engine::manual::PAGES } else { manual::PAGES };
            for page in pages {
                let module = format!("pub mod {} {{", page.topic.replace('-', "_"));
                let module = source.split(&module).nth(1).unwrap().split("\n}").next().unwrap();
                let names = |text: &str, before: &str| -> BTreeSet<String> {
                    let lines = text.lines().filter_map(|l| l.trim().strip_prefix(before)?.strip_prefix('['));
                    lines.filter_map(|l| l.split_once("]: ")).map(|(name, _)| name.to_owned()).collect()
                };
                assert_eq!(names(page.text, ""), names(module, "//! "), "{}", page.topic);
            }
        }
    }
}
