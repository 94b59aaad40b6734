//! Recorded measurements: each names what makes it comparable, and the manual's table is made from them.

use std::path::Path;

use tools::dev::measurements;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

#[test]
fn the_table_is_up_to_date() {
    let (old, new) = measurements::updated(root()).unwrap();
    assert!(old == new, "tools/docs/measured.md is not made from tests/measurements: run spgs-dev measurements");
}

#[test]
fn every_recording_is_complete_and_was_recorded_by_the_program() {
    let recordings = measurements::recordings(root()).unwrap();
    assert!(recordings.len() >= 3, "{}", recordings.len());
    for (file, record) in recordings {
        let text = |pointer: &str| record.pointer(pointer).and_then(|v| v.as_str()).unwrap_or_default().to_owned();
        assert!(text("/command").contains("spgs"), "{file}: {}", text("/command"));
        let commit = text("/program/commit");
        let hash = commit.strip_suffix("-modified").unwrap_or(&commit);
        assert!(hash.len() == 40 && hash.chars().all(|c| c.is_ascii_hexdigit()), "{file}: {commit}");
        assert!(text("/device/vulkan").starts_with("1."), "{file}");
    }
}

#[test]
fn the_list_of_commands_is_accepted_by_the_command_line() {
    use clap::Parser as _;
    let commands = measurements::commands("x");
    let (last, recorded) = commands.split_last().unwrap();
    assert!(last.contains("spgs-dev -- measurements"));
    for command in recorded {
        let words = command.split_whitespace();
        if let Err(error) = tools::cli::args::Cli::try_parse_from(words) {
            panic!("{command}: {error}");
        }
    }
}
