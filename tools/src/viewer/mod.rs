//! `spgs view`: a window to fly through a moving scene, scrub its time and see what every millisecond goes to.
//!
//! ```text
//! winit events ──► egui ──► input, panel ──► State (camera, time, settings, requests)
//!                                               │
//!                    Renderer ──► display ──► Presenter ──► window     (all on the device: gui.rs)
//! ```
//!
//! In the edit mode (`editing`) input becomes commands of the language of edits, which the engine carries out.
//!
//! Camera, time, statistics and input are plain code without window or device (`navigator`, `timeline`, `statistics`,
//! `input`). Frames are drawn while something moves; a still picture costs nothing. The interface runs when something happened
//! to it, and is drawn as it was in the frames between; `latency` measures how soon input is seen.

mod actions;
mod adaptive;
mod editing;
mod first;
mod gui;
mod held;
mod input;
mod interface;
mod known;
mod labels;
mod latency;
mod load;
mod losses;
mod model;
mod navigator;
mod overlay;
mod panel;
mod program;
mod record;
mod recovery;
mod state;
mod statistics;
mod theme;
mod timeline;
mod turn;
mod widgets;

pub use self::program::run;
pub use self::turn::ALLOCATIONS;
