//! What is said of mistakes around the modes of `spgs bench`.

use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory as _};

use super::args::Cli;

/// What were options once, with the words that are now in their place.
const OLDER: [(&str, &str); 6] = [
    ("--until-psnr", "train --until-psnr X"),
    ("--train", "train"),
    ("--sweep", "sweep"),
    ("--paper", "paper"),
    ("--ablation", "ablation DATA"),
    ("--hard-cases", "hard-cases"),
];

/// More than clap says of a mistake, if there is more: an option that has become a mode, and options in front of a mode.
pub fn advice(words: &[String], parsed: Option<&ArgMatches>) -> Option<String> {
    match parsed {
        Some(matches) => misplaced(matches),
        None => older(words),
    }
}

/// The new form of an option of `spgs bench` that is none any more.
fn older(words: &[String]) -> Option<String> {
    let bench = words.iter().position(|w| w == "bench")?;
    let rest = &words[bench + 1..];
    let command = Cli::command();
    let modes = command.find_subcommand("bench")?;
    if rest.iter().any(|w| modes.find_subcommand(w).is_some()) {
        return None;
    }
    let given = |option: &str| rest.iter().any(|w| w.split('=').next() == Some(option));
    let (option, mode) = OLDER.into_iter().find(|(option, _)| given(option))?;
    let sweep = if option == "--train" && given("--sweep") { " --sweep" } else { "" };
    Some(format!("`spgs bench {option}{sweep}` is now `spgs bench {mode}{sweep}`"))
}

/// Options of `spgs bench` without a mode, in front of one.
fn misplaced(matches: &ArgMatches) -> Option<String> {
    let given = matches.subcommand_matches("bench")?;
    let mode = given.subcommand_name()?;
    let command = Cli::command();
    let bench = command.find_subcommand("bench")?;
    let stray =
        bench.get_arguments().find(|a| given.value_source(a.get_id().as_str()) == Some(ValueSource::CommandLine))?;
    let name = stray.get_long().map_or_else(|| "a model".to_owned(), |long| format!("--{long}"));
    Some(format!("{name} in front of `{mode}`: what belongs to a mode follows it, `spgs bench {mode} …`"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn said(words: &str) -> Option<String> {
        let words: Vec<String> = words.split_whitespace().map(str::to_owned).collect();
        let matches =
            Cli::command().try_get_matches_from(std::iter::once("spgs").chain(words.iter().map(String::as_str)));
        advice(&words, matches.as_ref().ok())
    }

    #[test]
    fn an_older_option_is_answered_with_its_mode() {
        for (old, new) in [
            ("bench --train --synthetic 10", "spgs bench train`"),
            ("bench --width 16 --train --sweep", "spgs bench train --sweep`"),
            ("bench --train --until-psnr 20 --cameras d", "spgs bench train --until-psnr X`"),
            ("bench --iterations 4 --ablation=d", "spgs bench ablation DATA`"),
            ("--quiet bench m.ply --sweep", "spgs bench sweep`"),
            ("bench --paper", "spgs bench paper`"),
            ("bench --hard-cases --runs 2", "spgs bench hard-cases`"),
        ] {
            assert!(said(old).unwrap().ends_with(new), "{old}: {:?}", said(old));
        }
        for other in ["bench --nonsense", "bench train --paper", "render --train", "bench sweep --train"] {
            assert_eq!(said(other), None, "{other}");
        }
    }

    #[test]
    fn options_stand_behind_their_mode() {
        assert!(said("bench --synthetic 5 train").unwrap().contains("--synthetic in front of `train`"));
        assert!(said("bench m.ply paper").unwrap().contains("a model in front of `paper`"));
        for fine in
            ["bench --quiet train", "bench --device 0 sweep", "bench", "bench m.ply", "bench frame m.ply --check"]
        {
            assert_eq!(said(fine), None, "{fine}");
        }
    }
}
