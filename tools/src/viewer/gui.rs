//! The window with its device: one frame from input to picture.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use egui::epaint::{ImageData, Primitive};
use engine::error::Result;
use engine::gpu::painter::{Mesh, TextureUpdate};
use engine::gpu::presenter::{Overlay, Presenter};
use engine::gpu::{Buffer, Gpu, GpuOptions, WindowHandle};
use engine::render::FrameId;
use engine::render::display::{DisplayOptions, Screen};
use engine::scene::{Camera, Scene};
use winit::window::Window;

use super::adaptive::Adaptive;
use super::input;
use super::load::Opened;
use super::model::Model;
use super::navigator::Thrust;
use super::overlay::{self, Projection};
use super::panel::{self, Info};
use super::record::Recording;
use super::state::{Request, State};
use super::statistics::{StageTimes, stage_of};
use super::theme;

/// Longest time that one frame lets pass, seconds: after a pause nothing jumps.
const MAX_STEP_S: f64 = 0.25;
/// Gaussians of a tile that get the last colour of the heat map.
const TILE_RANGE: f32 = 2000.0;

/// Everything that lives as long as the window. Dropped in this order.
pub(super) struct Gui {
    screen: Screen,
    pub(super) model: Model,
    presenter: Presenter,
    pub(super) egui: egui_winit::State,
    context: egui::Context,
    /// The latest frame, when it was not finished yet.
    pending: Option<FrameId>,
    /// The latest finished frame had room; otherwise the window still shows an older one.
    pub(super) complete: bool,
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
    pub(super) fn new(window: Window, options: &GpuOptions, state: &State) -> Result<Self> {
        let window = Arc::new(window);
        let handle: Arc<dyn WindowHandle> = Arc::clone(&window) as Arc<dyn WindowHandle>;
        let (gpu, surface) = Gpu::with_window(options, &handle)?;
        let presenter = Presenter::new(surface, state.settings.vsync)?;
        let context = egui::Context::default();
        theme::apply(&context);
        // Frames may be slow, and a long press means nothing else: what does not move is a click.
        context.options_mut(|o| o.input_options.max_click_duration = f64::INFINITY);
        let scale = Some(window.scale_factor() as f32);
        let egui = egui_winit::State::new(context.clone(), egui::ViewportId::ROOT, &window, scale, None, Some(8192));
        let model = Model::new(&gpu, PathBuf::new(), Scene::default(), &state.settings)?;
        let info = Info { device: gpu.info().name.clone(), ..Info::default() };
        Ok(Self {
            screen: Screen::new(&gpu)?,
            model,
            presenter,
            egui,
            context,
            pending: None,
            complete: true,
            fresh: true,
            info,
            recording: None,
            last: None,
            was_animated: false,
            adaptive: Adaptive::new(),
            share: 1.0,
            wants_full: false,
            resized: true,
            vsync: state.settings.vsync,
            gpu,
            window,
        })
    }

    /// Shows another model.
    pub(super) fn set_model(&mut self, opened: Opened, state: &mut State) -> Result<()> {
        self.pending = None;
        // The old one goes first: the peak is the larger of the two, not the sum.
        self.model = Model::new(&self.gpu, PathBuf::new(), Scene::default(), &state.settings)?;
        self.model = Model::new(&self.gpu, opened.path, opened.scene, &state.settings)?;
        self.fresh = true;
        let scene = &self.model.scene;
        self.info = Info {
            device: self.gpu.info().name.clone(),
            model: self.model.name(),
            gaussians: scene.gaussians.len(),
            superpoints: self.model.superpoints(),
            key_times: scene.motion.as_ref().map_or(0, |m| m.times.len()),
            ..Info::default()
        };
        state.extent = (self.model.center, self.model.radius);
        state.selection = None;
        state.timeline.set_range(self.model.time_range);
        self.window.set_title(&format!("{} – spgs", self.info.model));
        Ok(())
    }

    /// The window has another size, or was hidden.
    pub(super) fn resized(&mut self) {
        self.resized = true;
    }

    /// One frame. Nothing happens while the window is minimised.
    pub(super) fn frame(&mut self, state: &mut State) -> Result<Next> {
        let size: [u32; 2] = self.window.inner_size().into();
        if size.contains(&0) {
            return Ok(Next::WhenAsked);
        }
        if self.resized || self.presenter.is_stale() || self.vsync != state.settings.vsync {
            (self.resized, self.vsync) = (false, state.settings.vsync);
            self.presenter.resize(size, self.vsync)?;
        }
        if !self.presenter.begin()? {
            return Ok(if self.presenter.is_stale() { Next::Now } else { Next::WhenAsked });
        }
        let dt = self.tick(state);
        let input = self.egui.take_egui_input(&self.window);
        for file in &input.dropped_files {
            state.requests.extend(file.path.clone().map(Request::Open));
        }
        let output = self.interface(input, state, dt)?;
        let picture = self.scene(state)?;
        self.show(&picture, output.textures_delta, output.shapes, output.pixels_per_point)?;
        self.egui.handle_platform_output(&self.window, output.platform_output);
        self.was_animated = state.is_animated();
        let delay = output.viewport_output.get(&egui::ViewportId::ROOT).map_or(Duration::MAX, |v| v.repaint_delay);
        if self.was_animated || delay.is_zero() {
            return Ok(Next::Now);
        }
        // The last frame of a movement must be right: nobody will look after it otherwise.
        if !self.finish(state)? {
            return Ok(Next::Now);
        }
        Ok(if delay < Duration::from_secs(3600) { Next::After(delay) } else { Next::WhenAsked })
    }

    /// Seconds since the last frame; 0 after a pause.
    fn tick(&mut self, state: &mut State) -> f64 {
        let now = Instant::now();
        let passed = self.last.map_or(0.0, |last| now.duration_since(last).as_secs_f64());
        self.last = Some(now);
        if !self.was_animated {
            return 0.0;
        }
        state.statistics.frame(passed);
        if self.share == self.adaptive.share() {
            self.adaptive.frame(passed);
        }
        passed.min(MAX_STEP_S)
    }

    fn interface(&mut self, input: egui::RawInput, state: &mut State, dt: f64) -> Result<egui::FullOutput> {
        let Self { context, model, info, presenter, .. } = self;
        let (size, scale) = (presenter.size(), f64::from(context.pixels_per_point()));
        state.interacting = false;
        state.age_messages();
        let mut moved = Ok(());
        let output = context.run(input, |context| {
            panel::draw(context, state, info);
            egui::CentralPanel::default().frame(egui::Frame::NONE).show(context, |ui| {
                let area = ui.max_rect();
                let response = ui.interact(area, ui.id().with("scene"), egui::Sense::click_and_drag());
                let thrust = input::scene_input(ui, &response, state);
                state.view_center = [f64::from(area.center().x) * scale, f64::from(area.center().y) * scale];
                moved = advance(state, model, dt, thrust);
                let camera = state.view(size);
                let projection = Projection::new(camera, state.navigator.pose.distance, 1.0 / scale);
                let painter = context.layer_painter(egui::LayerId::background()).with_clip_rect(area);
                overlay::draw(&painter, &projection, state, model);
            });
            if !state.messages.is_empty() {
                context.request_repaint_after(Duration::from_millis(500));
            }
        });
        moved.map(|()| output)
    }

    /// Submits the scene; the pixels are complete for what follows in the queue.
    fn scene(&mut self, state: &mut State) -> Result<Buffer> {
        self.finish(state)?;
        let size = self.presenter.size();
        let camera = state.view(size);
        if let Some(recording) = &mut self.recording {
            let centered = Camera { cx: 0.5 * f64::from(size[0]), cy: 0.5 * f64::from(size[1]), ..camera.clone() };
            recording.frame(if self.was_animated { state.step } else { 0.0 }, || centered.clone());
            state.recording = Some(recording.len());
        }
        let distance = state.navigator.pose.distance;
        self.share = self.share(state);
        let renderer = self.model.renderer(&self.gpu, &state.settings, state.selection, self.share)?;
        let frame = if std::mem::take(&mut self.fresh) {
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
        let mut stages: StageTimes = [0.0; 6];
        for timing in renderer.timings(frame)? {
            stages[stage_of(&timing.label)] += (timing.us / 1e3) as f32;
        }
        state.statistics.stages(stages);
        self.info.rendered = renderer.rendered_size();
        self.info.memory = renderer.memory();
        Ok(true)
    }

    fn show(
        &mut self,
        picture: &Buffer,
        textures: egui::TexturesDelta,
        shapes: Vec<egui::epaint::ClippedShape>,
        pixels_per_point: f32,
    ) -> Result<()> {
        let primitives = self.context.tessellate(shapes, pixels_per_point);
        let updates: Vec<TextureUpdate<'_>> = textures
            .set
            .iter()
            .map(|(id, delta)| {
                let ImageData::Color(image) = &delta.image;
                TextureUpdate {
                    id: texture_id(*id),
                    part: delta.pos.map(|p| p.map(|v| v as u32)),
                    size: image.size.map(|v| v as u32),
                    rgba: bytemuck::cast_slice(&image.pixels),
                }
            })
            .collect();
        let forget: Vec<u64> = textures.free.iter().map(|id| texture_id(*id)).collect();
        let meshes = || {
            primitives.iter().filter_map(|p| match &p.primitive {
                Primitive::Mesh(mesh) => Some(Mesh {
                    vertices: bytemuck::cast_slice(&mesh.vertices),
                    indices: &mesh.indices,
                    clip: [p.clip_rect.min.x, p.clip_rect.min.y, p.clip_rect.max.x, p.clip_rect.max.y],
                    texture: texture_id(mesh.texture_id),
                }),
                Primitive::Callback(_) => None,
            })
        };
        let overlay = Overlay { updates: &updates, forget: &forget, meshes, pixels_per_point };
        self.presenter.show(picture, overlay)?;
        Ok(())
    }

    /// The pixels of the latest frame and their size, without the interface.
    pub(super) fn pixels(&self) -> Option<(&Buffer, [u32; 2], bool)> {
        self.screen.pixels().map(|(buffer, size)| (buffer, size, self.presenter.is_bgra()))
    }

    /// Size of the window, pixels.
    pub(super) fn size(&self) -> [u32; 2] {
        self.presenter.size()
    }

    /// Pixels per point of the interface.
    pub(super) fn scale(&self) -> f32 {
        self.context.pixels_per_point()
    }
}

impl Drop for Gui {
    /// Nothing may be freed while the device works with it, be it said to be lost or not.
    fn drop(&mut self) {
        if let Err(error) = self.gpu.wait_idle() {
            log::debug!("closing the window: {error}");
        }
    }
}

/// Lets time pass for the scene and the camera.
fn advance(state: &mut State, model: &mut Model, dt: f64, thrust: Thrust) -> Result<()> {
    state.step = dt;
    state.interacting |=
        state.navigator.advance(dt, thrust) || thrust != Thrust { fast: thrust.fast, ..Thrust::default() };
    state.timeline.advance(dt);
    if state.settings.centers || state.selection.is_some() {
        model.pose(state.timeline.time, state.settings.motion)?;
    }
    Ok(())
}

fn texture_id(id: egui::TextureId) -> u64 {
    match id {
        egui::TextureId::Managed(n) => n << 1,
        egui::TextureId::User(n) => n << 1 | 1,
    }
}
