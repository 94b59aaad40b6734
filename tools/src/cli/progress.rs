//! A progress bar with remaining time, for work on many frames; nothing when quiet or when nobody looks.

use std::io::IsTerminal as _;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// A bar over `total` frames on standard error.
pub fn bar(total: u64, quiet: bool) -> ProgressBar {
    shown(Some(total), quiet || total < 2, "{bar:40} {pos}/{len} frames, {per_sec}, {eta} left")
}

/// A count of `what` that nobody knows the end of.
pub fn counter(what: &str, quiet: bool) -> ProgressBar {
    shown(None, quiet, "{spinner} {pos} {msg}, {elapsed}").with_message(what.to_owned())
}

/// A bar over the commands of a script, with the one that is carried out.
pub fn steps(total: u64, quiet: bool) -> ProgressBar {
    let bar = shown(Some(total), quiet, "{bar:30} {pos}/{len} edits, {elapsed}; {wide_msg}");
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

/// A bar over the times of photos, with the search at one of them.
pub fn poses(total: u64, quiet: bool) -> ProgressBar {
    shown(Some(total), quiet, "{bar:30} {pos}/{len} times, {elapsed}; {wide_msg}")
}

/// A bar over the settings of a sweep, with the one that is measured.
pub fn sweep(total: u64, quiet: bool) -> ProgressBar {
    shown(Some(total), quiet, "{bar:30} {pos}/{len}, {eta} left; {msg}")
}

/// A bar over the iterations of a training run, `done` of them already behind.
pub fn training(total: u64, done: u64, quiet: bool) -> ProgressBar {
    let bar = shown(Some(total), quiet, "{bar:30} {pos}/{len}, {per_sec}, {eta} left; {msg}").with_position(done);
    bar.reset_eta();
    bar
}

/// A bar over the time that a step has, in milliseconds.
pub fn budget(title: &str, time: Duration, quiet: bool) -> ProgressBar {
    let bar = shown(Some(time.as_millis() as u64), quiet, "{msg:34} {bar:30} {elapsed} gone, at most {eta} left");
    bar.with_message(title.to_owned())
}

fn shown(total: Option<u64>, quiet: bool, template: &str) -> ProgressBar {
    if quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::stderr());
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}
