//! What the window shows and what its user asked for: plain data between input, interface and drawing.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use engine::render::display::DisplayMode;
use engine::render::{FrameStatistics, Picked, Quality};
use engine::scene::{Camera, MotionSource};
use glam::DVec3;

use super::editing::mode::{Ask, EditMode};
use super::known::KnownPoses;
use super::navigator::Navigator;
use super::statistics::Statistics;
use super::timeline::Timeline;

/// Seconds that a message stays.
const MESSAGE_S: f64 = 5.0;
/// Backgrounds that the key goes through, after the one of the command line.
const BACKGROUNDS: [[f32; 3]; 3] = [[0.0; 3], [1.0; 3], [0.18, 0.2, 0.24]];

/// One line of the list of keys.
pub(super) struct Binding {
    pub(super) keys: &'static str,
    pub(super) does: &'static str,
}

pub(super) const fn binding(keys: &'static str, does: &'static str) -> Binding {
    Binding { keys, does }
}

/// What of the scene is shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Show {
    #[default]
    Color,
    Depth,
    Opacity,
    Tiles,
    /// Every Gaussian in the colour of its superpoint.
    Superpoints,
    /// How far off each pixel may be, if that is known (`--confidence`).
    ExpectedError,
}

impl Show {
    pub(super) const ALL: [Self; 6] =
        [Self::Color, Self::Depth, Self::Opacity, Self::Tiles, Self::Superpoints, Self::ExpectedError];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Color => "Colour",
            Self::Depth => "Depth",
            Self::Opacity => "Opacity",
            Self::Tiles => "Tile heat map",
            Self::Superpoints => "Superpoints",
            Self::ExpectedError => "Expected error",
        }
    }

    pub(super) fn display(self) -> DisplayMode {
        match self {
            Self::Color | Self::Superpoints | Self::ExpectedError => DisplayMode::Color,
            Self::Depth => DisplayMode::Depth,
            Self::Opacity => DisplayMode::Opacity,
            Self::Tiles => DisplayMode::Tiles,
        }
    }
}

/// Everything that the panel changes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Settings {
    pub(super) show: Show,
    pub(super) background: [f32; 3],
    /// Share of the window's width and height that is rendered.
    pub(super) resolution: f32,
    /// Less of it while something moves and frames are slow.
    pub(super) adaptive: bool,
    pub(super) quality: Quality,
    pub(super) quality_name: &'static str,
    pub(super) motion: MotionSource,
    /// Near plane, when one was asked for.
    pub(super) near: Option<f32>,
    pub(super) vsync: bool,
    pub(super) centers: bool,
    pub(super) paths: bool,
    pub(super) frusta: bool,
    pub(super) panel: bool,
    pub(super) help: bool,
}

/// What was clicked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Selection {
    pub(super) picked: Picked,
    pub(super) superpoint: Option<u32>,
}

/// What the user asked for and the program does after the interface was drawn.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Request {
    Open(PathBuf),
    SavePng,
    SaveExr,
    ToggleRecording,
    /// Window position, points, and whether the camera goes there.
    Pick([f32; 2], bool),
    Edit(Ask),
    Quit,
}

/// A click on the scene, points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Click {
    Single(egui::Pos2),
    Double(egui::Pos2),
}

/// A line that goes by itself.
#[derive(Debug, Clone)]
pub(super) struct Message {
    pub(super) text: String,
    pub(super) is_error: bool,
    until: Instant,
}

/// The whole state of the window.
#[derive(Debug)]
pub(super) struct State {
    pub(super) settings: Settings,
    pub(super) navigator: Navigator,
    pub(super) timeline: Timeline,
    pub(super) statistics: Statistics,
    pub(super) frame: FrameStatistics,
    pub(super) selection: Option<Selection>,
    pub(super) edit: EditMode,
    /// Centre of the scene and the radius within which most of it lies.
    pub(super) extent: (DVec3, f64),
    /// How far off the model's images may be is known.
    pub(super) has_confidence: bool,
    /// How well the poses of superpoints are known, if that is.
    pub(super) poses: Option<Arc<KnownPoses>>,
    pub(super) cameras: Vec<Camera>,
    /// Which camera of the data set was gone to last.
    pub(super) camera: Option<usize>,
    pub(super) requests: Vec<Request>,
    /// Keys that were pressed with Ctrl and are still down: they do not fly when Ctrl is let go first.
    pub(super) shortcuts: Vec<egui::Key>,
    /// Where the scene was clicked last, points.
    pub(super) clicked: Option<egui::Pos2>,
    /// Clicks of the scene that wait for their frame.
    pub(super) clicks: VecDeque<Click>,
    /// A field of the interface had the keyboard at the end of the last frame.
    pub(super) typing: bool,
    pub(super) messages: Vec<Message>,
    /// Frames recorded so far, while a path is recorded.
    pub(super) recording: Option<usize>,
    /// Name of the model that is being loaded.
    pub(super) loading: Option<String>,
    /// Frames follow each other to the end (`--frames`).
    pub(super) continuous: bool,
    /// The user moves something: the next frames follow at once.
    pub(super) interacting: bool,
    /// Where the camera's axis meets the window, pixels: the middle of what the interface leaves free.
    pub(super) view_center: [f64; 2],
    /// Height of the window, pixels.
    pub(super) window_height: f64,
    /// Seconds that the last frame let pass.
    pub(super) step: f64,
    pub(super) wants_to_quit: bool,
}

impl State {
    /// The camera for a window of this size.
    pub(super) fn view(&self, size: [u32; 2]) -> Camera {
        let [cx, cy] = self.view_center;
        Camera { cx, cy, ..self.navigator.pose.camera(size, self.timeline.time) }
    }

    /// The whole scene, from the direction that the camera looks in, within what the interface leaves free.
    pub(super) fn framing(&self) -> super::navigator::Pose {
        let focal = 0.5 * self.window_height / (0.5 * self.navigator.pose.fov_y).tan();
        let [cx, cy] = self.view_center;
        let angle = (cx.min(cy).max(1.0) / focal).atan();
        self.navigator.framing(self.extent.0, crate::cli::camera::MARGIN * self.extent.1, angle)
    }

    /// Shows a line for a while.
    pub(super) fn say(&mut self, text: impl Into<String>, is_error: bool) {
        let until = Instant::now() + std::time::Duration::from_secs_f64(MESSAGE_S);
        self.messages.push(Message { text: text.into(), is_error, until });
    }

    /// Drops messages whose time is over.
    pub(super) fn age_messages(&mut self) {
        let now = Instant::now();
        self.messages.retain(|m| m.until > now);
    }

    /// Goes to a camera of the data set, `by` further than the last.
    pub(super) fn next_camera(&mut self, by: isize) {
        if self.cameras.is_empty() {
            self.say("no cameras: start with --data DATA", false);
            return;
        }
        let count = self.cameras.len() as isize;
        let index = self.camera.map_or(if by > 0 { 0 } else { count - 1 }, |i| (i as isize + by).rem_euclid(count));
        self.go_to_camera(index as usize);
    }

    /// Goes to a camera of the data set, and to its time.
    pub(super) fn go_to_camera(&mut self, index: usize) {
        let Some(camera) = self.cameras.get(index) else { return };
        // The point that is looked at stays where it is in depth.
        let depth = (self.navigator.pose.target - camera.position).dot(camera.rotation.transpose().z_axis);
        let distance = if depth > 1e-3 { depth } else { self.navigator.pose.distance };
        let pose = super::navigator::Pose::of_camera(camera, distance);
        self.timeline.seek(camera.time);
        self.timeline.playing = false;
        self.navigator.glide_to(pose);
        self.camera = Some(index);
    }

    /// Shows how far off pixels may be, or says what is missing.
    pub(super) fn show_expected_error(&mut self) {
        if self.has_confidence {
            self.settings.show = Show::ExpectedError;
        } else {
            self.say("no expected errors: start with --confidence FILE", false);
        }
    }

    /// Another scene is shown, of which that is known or not.
    pub(super) fn set_confidence(&mut self, is_known: bool) {
        self.has_confidence = is_known;
        if !is_known && self.settings.show == Show::ExpectedError {
            self.settings.show = Show::Color;
            self.say("no expected errors of this scene", false);
        }
    }

    /// Another scene is shown, with poses that are known so well. What is new of them is shown.
    pub(super) fn know_poses(&mut self, poses: Option<Arc<KnownPoses>>) {
        self.settings.centers |= self.poses.is_none() && poses.is_some();
        self.poses = poses;
    }

    /// The next background.
    pub(super) fn cycle_background(&mut self) {
        let at = BACKGROUNDS.iter().position(|b| *b == self.settings.background);
        self.settings.background = BACKGROUNDS[at.map_or(0, |i| (i + 1) % BACKGROUNDS.len())];
    }

    /// Whether frames follow without anybody touching anything.
    pub(super) fn is_animated(&self) -> bool {
        self.continuous
            || self.timeline.playing
            || self.navigator.is_gliding()
            || self.interacting
            || self.loading.is_some()
    }
}
