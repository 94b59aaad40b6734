//! What the programs say: results on standard output, everything else on standard error, one line per mistake.

use std::io::Write as _;
use std::process::ExitCode;
use std::sync::{Mutex, OnceLock};

use engine::error::Result;

use crate::report::files::to_json;

/// Writes a line to standard output. A reader that went away (`spgs … | head`) is no error.
pub fn line(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "{text}");
}

/// Writes a line to standard error.
pub fn error_line(text: &str) {
    let mut out = std::io::stderr().lock();
    let _ = writeln!(out, "{text}");
}

/// Writes a value as indented JSON to standard output.
pub fn json(value: &impl serde::Serialize) -> Result<()> {
    line(&to_json(value)?);
    Ok(())
}

/// Runs a program's body: an error becomes one line and its exit code, a panic one line and exit code 1.
pub fn run_main(program: &str, body: impl FnOnce() -> Result<ExitCode> + std::panic::UnwindSafe) -> ExitCode {
    PROGRAM.get_or_init(|| program.to_owned());
    let _ = log::set_logger(&LOGGER).map(|()| log::set_max_level(log::LevelFilter::Warn));
    std::panic::set_hook(Box::new(|info| {
        let text = one_line(&info.to_string());
        *PANIC.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = text;
    }));
    match std::panic::catch_unwind(body) {
        Ok(Ok(code)) => code,
        Ok(Err(error)) => {
            error_line(&format!("{program}: {}", one_line(&error.to_string())));
            ExitCode::from(error.exit_code())
        }
        Err(_) => {
            let text = PANIC.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone();
            error_line(&format!("{program}: internal error, please report it: {text}"));
            ExitCode::from(1)
        }
    }
}

static PANIC: Mutex<String> = Mutex::new(String::new());
static PROGRAM: OnceLock<String> = OnceLock::new();

/// Collapses line breaks and runs of blanks.
pub fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Parses arguments with clap; help and version go to standard output, a mistake becomes one line and exit code 2. `advice` may
/// say more of a mistake than clap does: it gets the words, and what clap made of them unless that failed.
pub fn parse<T: clap::Parser>(
    program: &str,
    advice: impl Fn(&[String], Option<&clap::ArgMatches>) -> Option<String>,
) -> std::result::Result<T, ExitCode> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let refuse = |text: &str| {
        error_line(&format!("{program}: {}; see {} --help", one_line(text), asked::<T>(program, &words)));
        ExitCode::from(2)
    };
    let matches = T::command().try_get_matches();
    if let Some(text) = advice(&words, matches.as_ref().ok()) {
        return Err(refuse(&text));
    }
    matches.and_then(|m| T::from_arg_matches(&m)).map_err(|error| {
        if !error.use_stderr() {
            let _ = error.print();
            return ExitCode::SUCCESS;
        }
        let text = error.render().to_string();
        // Only what is wrong, without the usage block; without a subcommand clap answers with the help itself.
        let text = if error.kind() == clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
            "a subcommand is missing".to_owned()
        } else {
            let wrong = text.split("\n\nUsage:").next().unwrap_or_default();
            wrong.strip_prefix("error: ").unwrap_or(wrong).replace("\n\n  tip: ", "; ").trim().to_owned()
        };
        let text = text.split("\n\nFor more information").next().unwrap_or_default();
        refuse(&without_bad_advice(text))
    })
}

/// The program and the subcommands that were asked for, as `spgs bench train`.
fn asked<T: clap::Parser>(program: &str, words: &[String]) -> String {
    let (mut command, mut name) = (T::command(), program.to_owned());
    for word in words {
        if let Some(sub) = command.find_subcommand(word).cloned() {
            name = format!("{name} {word}");
            command = sub;
        }
    }
    name
}

/// clap's advice for a negative number, `-- -1`, would make it a file name.
fn without_bad_advice(text: &str) -> String {
    match text.split_once("; to pass '-") {
        Some((wrong, rest)) if rest.starts_with(|c: char| c.is_ascii_digit()) => {
            format!("{wrong}; a value that begins with - is given as --option=-1")
        }
        _ => text.to_owned(),
    }
}

struct Logger;
static LOGGER: Logger = Logger;

impl log::Log for Logger {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        // Only our own: naga, for one, warns of every decoration that it does not use.
        let ours = ["engine", "tools", "spgs"].iter().any(|name| metadata.target().starts_with(name));
        ours && metadata.level() <= log::Level::Warn
    }

    fn log(&self, record: &log::Record<'_>) {
        if self.enabled(record.metadata()) {
            let level = if record.level() == log::Level::Error { "error" } else { "warning" };
            let program = PROGRAM.get().map_or("spgs", String::as_str);
            error_line(&format!("{program}: {level}: {}", one_line(&record.args().to_string())));
        }
    }

    fn flush(&self) {}
}
