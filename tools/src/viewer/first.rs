//! The state in which the window opens, from the arguments.

use std::collections::VecDeque;

use engine::error::Result;
use engine::render::Quality;
use engine::scene::Scene;

use super::editing::mode::EditMode;
use super::navigator::{self, Navigator, Pose};
use super::state::{Settings, Show, State};
use super::statistics::Statistics;
use super::theme::PANEL_FROM;
use super::timeline::Timeline;
use crate::cli::args::ViewerArgs;
use crate::cli::{camera, model};

/// What the arguments ask for, before any model is there.
pub(super) fn first_state(args: &ViewerArgs) -> Result<State> {
    let cameras = match &args.data {
        Some(path) => model::load_cameras(path, args.split.as_deref(), [None; 2])?.cameras,
        None => Vec::new(),
    };
    let camera = camera::default_camera(&Scene::default(), args.size);
    let up = navigator::up_of_cameras(&cameras);
    let quality_name = Quality::PRESETS.iter().find(|(_, q)| *q == args.quality.chosen());
    let settings = Settings {
        show: Show::Color,
        background: args.look.background,
        resolution: args.quality.chosen().resolution,
        adaptive: !args.full_resolution,
        quality: Quality { resolution: 1.0, ..args.quality.chosen() },
        quality_name: quality_name.map_or("", |(name, _)| name),
        motion: args.look.motion_source(),
        near: args.near,
        vsync: !args.no_vsync,
        centers: false,
        paths: false,
        frusta: false,
        panel: args.size[0] as f32 >= PANEL_FROM,
        help: false,
    };
    Ok(State {
        settings,
        navigator: Navigator::new(Pose::of_camera(&camera, 1.0), up),
        timeline: Timeline::new([0.0, 0.0]),
        statistics: Statistics::default(),
        frame: engine::render::FrameStatistics::default(),
        selection: None,
        edit: EditMode::default(),
        extent: (glam::DVec3::ZERO, 1.0),
        has_confidence: false,
        poses: None,
        cameras,
        camera: None,
        requests: Vec::new(),
        shortcuts: Vec::new(),
        clicked: None,
        clicks: VecDeque::new(),
        typing: false,
        messages: Vec::new(),
        recording: None,
        loading: None,
        continuous: args.frames.is_some(),
        interacting: false,
        view_center: args.size.map(|s| 0.5 * f64::from(s)),
        window_height: f64::from(args.size[1]),
        step: 0.0,
        wants_to_quit: false,
    })
}

/// The state of a window that was just opened.
#[cfg(test)]
pub(super) fn test_state() -> State {
    use clap::Parser as _;
    let cli = crate::cli::args::Cli::try_parse_from(["spgs", "view", "--size", "640x480"]);
    let args = match cli.map(|c| c.command) {
        Ok(crate::cli::args::Command::View(args)) => args,
        other => unreachable!("{other:?}"),
    };
    first_state(&args).unwrap_or_else(|e| unreachable!("{e}"))
}
