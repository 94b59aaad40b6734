//! What every step of a session knows: the teacher, and how far the work is.

use std::borrow::Cow;

use engine::render::RenderOptions;
use engine::scene::Camera;
use engine::train::bake::Views;
use indicatif::ProgressBar;

use crate::cli::interrupt::{self, Interrupt};
use crate::cli::output;
use crate::command::convert::moment::Moments;

/// The teacher and how it is looked at.
pub(super) struct Taught<'a> {
    pub(super) moments: Moments<'a>,
    pub(super) views: Views<Camera>,
    pub(super) measured_in: String,
    pub(super) options: RenderOptions,
}

/// Shows what is done, and ends the program when it is asked to: nothing is written yet.
pub(super) fn step(bar: &ProgressBar, interrupt: &Interrupt, what: impl Into<Cow<'static, str>>, done: usize) {
    bar.set_message(what);
    bar.set_position(done as u64);
    if interrupt.is_set() {
        bar.finish_and_clear();
        output::error_line("spgs: interrupted; nothing is written");
        std::process::exit(interrupt::CODE);
    }
}
