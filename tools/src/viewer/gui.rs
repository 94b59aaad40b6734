//! The window with its device: one frame from input to picture.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use engine::error::Result;
use engine::gpu::presenter::Presenter;
use engine::gpu::{Buffer, Gpu, GpuOptions, WindowHandle};
use engine::render::FrameId;
use engine::render::display::{DisplayOptions, Screen};
use engine::scene::{Camera, Scene};
use winit::event::WindowEvent;
use winit::window::Window;

use super::adaptive::Adaptive;
use super::interface::Interface;
use super::latency::{Latency, Visible};
use super::load::Opened;
use super::model::Model;
use super::panel::{Info, Numbers};
use super::record::Recording;
use super::state::State;
use super::statistics::{STAGES, StageTimes, stage_of};

/// Longest time that one frame lets pass, seconds: after a pause nothing jumps.
const MAX_STEP_S: f64 = 0.25;
/// Time that the first frame of a movement lets pass: it shows the movement already.
const FIRST_STEP_S: f64 = 1.0 / 60.0;
/// Gaussians of a tile that get the last colour of the heat map.
const TILE_RANGE: f32 = 2000.0;

/// Everything that lives as long as the window. Dropped in this order.
pub(super) struct Gui {
    screen: Screen,
    pub(super) model: Model,
    presenter: Presenter,
    pub(super) interface: Interface,
    pub(super) latency: Latency,
    /// The latest frame, when it was not finished yet.
    pending: Option<FrameId>,
    /// The latest finished frame had room; otherwise the window still shows an older one.
    pub(super) complete: bool,
    /// The last call of [`Self::frame`] has drawn the scene.
    pub(super) drew: bool,
    /// The model was never drawn.
    fresh: bool,
    pub(super) info: Info,
    pub(super) recording: Option<Recording>,
    last: Option<Instant>,
    was_animated: bool,
    adaptive: Adaptive,
    /// Share of the resolution of the latest frame.
    share: f32,
    /// The next frame has all pixels even if something moves.
    pub(super) wants_full: bool,
    resized: bool,
    /// How often the window got images of another size.
    pub(super) resizes: u64,
    /// Pixels; zero while it is minimised.
    window_size: [u32; 2],
    vsync: bool,
    pub(super) gpu: Gpu,
    pub(super) window: Arc<Window>,
}

/// When the next frame is due.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Next {
    Now,
    After(Duration),
    WhenAsked,
}

impl Gui {
    pub(super) fn new(window: Arc<Window>, options: &GpuOptions, state: &State) -> Result<Self> {
        let handle: Arc<dyn WindowHandle> = Arc::clone(&window) as Arc<dyn WindowHandle>;
        let (gpu, surface) = Gpu::with_window(options, &handle)?;
        let presenter = Presenter::new(surface, state.settings.vsync)?;
        let interface = Interface::new(&window);
        let model = Model::new(&gpu, PathBuf::new(), Arc::default(), &state.settings)?;
        let info = Info { device: gpu.info().name.clone(), ..Info::default() };
        Ok(Self {
            screen: Screen::new(&gpu)?,
            model,
            presenter,
            interface,
            latency: Latency::default(),
            pending: None,
            complete: true,
            drew: false,
            fresh: true,
            info,
            recording: None,
            last: None,
            was_animated: false,
            adaptive: Adaptive::new(),
            share: 1.0,
            wants_full: false,
            resized: true,
            resizes: 0,
            window_size: [0, 0],
            vsync: state.settings.vsync,
            gpu,
            window,
        })
    }

    /// Shows another model.
    pub(super) fn set_model(&mut self, opened: Opened, state: &mut State) -> Result<()> {
        (self.pending, self.last) = (None, None);
        // The old one goes first: the peak is the larger of the two, not the sum.
        self.model = Model::new(&self.gpu, PathBuf::new(), Arc::default(), &state.settings)?;
        self.model = Model::new(&self.gpu, opened.path, opened.scene, &state.settings)?;
        state.set_confidence(opened.expected.is_some());
        self.model.expect(opened.expected);
        state.know_poses(opened.poses);
        self.fresh = true;
        self.count();
        state.extent = (self.model.center, self.model.radius);
        state.selection = None;
        state.timeline.set_range(self.model.time_range);
        self.window.set_title(&format!("{} – spgs", self.info.model));
        Ok(())
    }

    /// Shows another scene of the same model.
    pub(super) fn change_scene(&mut self, scene: Arc<Scene>, state: &mut State) -> Result<()> {
        (self.pending, self.last) = (None, None);
        let path = std::mem::take(&mut self.model.path);
        // The old one goes first: the peak is the larger of the two, not the sum.
        self.model = Model::new(&self.gpu, PathBuf::new(), Arc::default(), &state.settings)?;
        self.model = Model::new(&self.gpu, path, scene, &state.settings)?;
        // Edited Gaussians are not those that training views were compared with.
        state.set_confidence(false);
        state.know_poses(None);
        self.fresh = true;
        self.count();
        let playing = state.timeline.playing;
        state.timeline.set_range(self.model.time_range);
        state.timeline.playing &= playing;
        Ok(())
    }

    /// What the panel says about the model.
    fn count(&mut self) {
        let scene = &self.model.scene;
        self.info = Info {
            device: self.gpu.info().name.clone(),
            model: self.model.name(),
            gaussians: scene.gaussians.len(),
            superpoints: self.model.superpoints(),
            key_times: scene.deformation.key_times().len(),
            ..Info::default()
        };
    }

    /// The window has another size, or was hidden.
    pub(super) fn resized(&mut self) {
        self.resized = true;
    }

    /// One frame. Nothing happens while the window is minimised.
    pub(super) fn frame(&mut self, state: &mut State) -> Result<Next> {
        self.drew = false;
        // Asked for only when it may be another: the answer comes from the X server.
        if self.resized || self.presenter.is_stale() {
            self.window_size = self.window.inner_size().into();
        }
        let size = self.window_size;
        if size.contains(&0) {
            return Ok(Next::WhenAsked);
        }
        if self.resized || self.presenter.is_stale() || self.vsync != state.settings.vsync {
            (self.resized, self.vsync) = (false, state.settings.vsync);
            self.resizes += u64::from(size != self.presenter.size());
            self.presenter.resize(size, self.vsync)?;
        }
        if !self.presenter.begin()? {
            return Ok(if self.presenter.is_stale() { Next::Now } else { Next::WhenAsked });
        }
        let dt = self.tick(state);
        let ran = self.interface.is_due(state);
        let numbers = Numbers::of(state, &self.info);
        if ran {
            let Self { interface, model, info, latency, window, presenter, .. } = self;
            interface.run(window, presenter.size(), (state, model, info), dt, latency)?;
        } else {
            self.interface.pass(state, &mut self.model, dt)?;
        }
        let picture = self.scene(state)?;
        self.drew = true;
        let shown = self.interface.show(&mut self.presenter, &picture)?;
        self.latency.presented(Visible::of(state, self.interface.thrust()), shown);
        self.was_animated = state.is_animated();
        let moves_on = self.was_animated || self.interface.delay().is_some_and(|d| d.is_zero());
        if !moves_on {
            // The last frame of a movement must be right: nobody will look after it otherwise.
            let fits = self.finish(state)?;
            self.gpu.wait(shown)?;
            self.landed();
            // The interface was laid out before the frame was drawn: it may show the numbers of one before.
            if fits && ran && numbers == Numbers::of(state, &self.info) {
                self.latency.rest();
                return Ok(self.interface.delay().map_or(Next::WhenAsked, Next::After));
            }
            self.interface.want();
        }
        // What is done from now on is seen in the next frame: it is taken when the window has given an image, which may
        // take a refresh of the display, and when the frame before the one on its way has been finished.
        self.presenter.begin()?;
        self.landed();
        Ok(Next::Now)
    }

    /// Frames that the device has finished have reached the window.
    fn landed(&mut self) {
        let gpu = &self.gpu;
        self.latency.finished(|submission| gpu.is_finished(submission).unwrap_or(false));
    }

    /// An event that may change the picture, before anything is done about it.
    pub(super) fn event(&mut self, event: &WindowEvent) -> Result<()> {
        if self.latency.is_input(event) {
            self.latency.take(Instant::now(), self.presenter.in_flight()?);
        }
        Ok(())
    }

    /// Seconds since the last frame; little after a pause.
    fn tick(&mut self, state: &mut State) -> f64 {
        let now = Instant::now();
        let Some(last) = self.last.replace(now).filter(|_| self.was_animated) else { return FIRST_STEP_S };
        let passed = now.duration_since(last).as_secs_f64();
        state.statistics.frame(passed);
        if self.share == self.adaptive.share() {
            self.adaptive.frame(passed);
        }
        passed.min(MAX_STEP_S)
    }

    /// Submits the scene; the pixels are complete for what follows in the queue.
    fn scene(&mut self, state: &mut State) -> Result<Buffer> {
        self.finish(state)?;
        let size = self.presenter.size();
        let camera = state.view(size);
        if let Some(recording) = &mut self.recording {
            let centered = |size: [u32; 2]| {
                let [cx, cy] = size.map(|s| 0.5 * f64::from(s));
                Camera { cx, cy, ..state.view(size) }
            };
            recording.frame(if self.was_animated { state.step } else { 0.0 }, size, centered);
            state.recording = Some(recording.len());
        }
        let distance = state.navigator.pose.distance;
        self.share = self.share(state);
        let renderer = self.model.renderer(&self.gpu, &state.settings, state.selection, self.share)?;
        let frame = if std::mem::take(&mut self.fresh) {
            // What comes to the device once says nothing about frames.
            self.last = None;
            renderer.draw(&camera, camera.time)?.0
        } else {
            renderer.submit(&camera, camera.time)?
        };
        self.pending = Some(frame);
        let reach = 1.5 * state.extent.1;
        let options = DisplayOptions {
            mode: state.settings.show.display(),
            size,
            bgra: self.presenter.is_bgra(),
            depth_range: [(distance - reach).max(0.0) as f32, (distance + reach) as f32],
            tile_range: TILE_RANGE,
        };
        Ok(self.screen.submit(renderer, frame, &options)?.clone())
    }

    /// Share of the resolution that the next frame has.
    fn share(&mut self, state: &State) -> f32 {
        let full = std::mem::take(&mut self.wants_full) || !state.settings.adaptive || !state.is_animated();
        if full { 1.0 } else { self.adaptive.share() }
    }

    /// The latest frame has not all pixels that were asked for.
    pub(super) fn is_reduced(&self) -> bool {
        self.share < 1.0
    }

    /// Waits for the latest frame and takes its numbers; false when it did not fit its buffers, which then have grown.
    pub(super) fn finish(&mut self, state: &mut State) -> Result<bool> {
        let Some(frame) = self.pending.take() else { return Ok(true) };
        let renderer = self.model.current();
        let finished = renderer.finish(frame)?;
        self.complete = finished.is_some();
        let Some(statistics) = finished else { return Ok(false) };
        state.frame = statistics;
        let mut stages: StageTimes = [0.0; STAGES.len()];
        renderer.each_timing(frame, |label, us| stages[stage_of(label)] += (us / 1e3) as f32)?;
        state.statistics.stages(stages);
        self.info.rendered = renderer.rendered_size();
        self.info.memory = renderer.memory();
        Ok(true)
    }

    /// The pixels of the latest frame and their size, without the interface.
    pub(super) fn pixels(&self) -> Option<(&Buffer, [u32; 2], bool)> {
        self.screen.pixels().map(|(buffer, size)| (buffer, size, self.presenter.is_bgra()))
    }

    /// Size of the window, pixels; never zero, be there images of it yet or not.
    pub(super) fn size(&self) -> [u32; 2] {
        let shown = self.presenter.size();
        if shown.contains(&0) { <[u32; 2]>::from(self.window.inner_size()).map(|s| s.max(1)) } else { shown }
    }

    /// Pixels per point of the interface.
    pub(super) fn scale(&self) -> f32 {
        self.interface.scale()
    }
}

impl Drop for Gui {
    /// Nothing may be freed while the device works with it, be it said to be lost or not.
    fn drop(&mut self) {
        self.presenter.rest();
    }
}
