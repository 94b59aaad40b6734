//! The interface over the scene: run when something happened to it, drawn again as it was in the frames between.

use std::time::{Duration, Instant};

use egui::epaint::{ClippedPrimitive, ImageData, Primitive};
use engine::error::Result;
use engine::gpu::painter::{Mesh, TextureUpdate};
use engine::gpu::presenter::{Overlay, Presenter};
use engine::gpu::{Buffer, Submission};
use winit::event::WindowEvent;
use winit::window::Window;

use super::editing::mode::Ask;
use super::held;
use super::input;
use super::labels;
use super::latency::{Latency, Visible};
use super::model::Model;
use super::navigator::Thrust;
use super::overlay::{self, Projection};
use super::panel::{self, Info};
use super::state::{Request, State};
use super::theme;

/// How often the numbers of a scene that moves are brought up to date.
const LIVE: Duration = Duration::from_millis(100);
/// How often messages are looked at, to let them go.
const MESSAGES: Duration = Duration::from_millis(500);
/// egui says a longer time when it wants nothing.
const NEVER: Duration = Duration::from_secs(3600);

/// egui between the window and the presenter.
pub(super) struct Interface {
    context: egui::Context,
    winit: egui_winit::State,
    /// What was drawn last, and textures that the device has not got yet.
    primitives: Vec<ClippedPrimitive>,
    textures: egui::TexturesDelta,
    pixels_per_point: f32,
    /// Something happened that it has not seen.
    wanted: bool,
    /// When it wants to run by itself.
    due: Option<Instant>,
    last: Option<Instant>,
    /// Keys that are held, and whether the scene is.
    thrust: Thrust,
    dragged: bool,
    held: held::Held,
    /// How often it ran.
    pub(super) runs: u64,
}

impl Interface {
    pub(super) fn new(window: &Window) -> Self {
        let context = egui::Context::default();
        theme::apply(&context);
        // Frames may be slow, and a long press means nothing else: what does not move is a click.
        context.options_mut(|o| o.input_options.max_click_duration = f64::INFINITY);
        let scale = Some(window.scale_factor() as f32);
        let winit = egui_winit::State::new(context.clone(), egui::ViewportId::ROOT, window, scale, None, Some(8192));
        Self {
            context,
            winit,
            primitives: Vec::new(),
            textures: egui::TexturesDelta::default(),
            pixels_per_point: 1.0,
            wanted: true,
            due: None,
            last: None,
            thrust: Thrust::default(),
            dragged: false,
            held: held::Held::default(),
            runs: 0,
        }
    }

    /// Takes an event; true when a frame is due because of it.
    pub(super) fn event(&mut self, window: &Window, event: &WindowEvent) -> bool {
        let first = self.winit.egui_input().events.len();
        let repaint = self.winit.on_window_event(window, event).repaint;
        if let WindowEvent::KeyboardInput { event, .. } = event {
            held::follow(&mut self.held, self.winit.egui_input_mut(), first, event.physical_key, event.state);
        }
        self.wanted |= repaint;
        repaint
    }

    /// A field takes the keys.
    pub(super) fn wants_keyboard(&self) -> bool {
        self.context.wants_keyboard_input()
    }

    /// It runs in the next frame.
    pub(super) fn want(&mut self) {
        self.wanted = true;
    }

    /// Whether it runs in this frame. What is drawn over the scene follows the camera, the rest may be a moment old.
    pub(super) fn is_due(&self, state: &State) -> bool {
        let now = Instant::now();
        let s = &state.settings;
        self.wanted
            || s.centers
            || s.paths
            || s.frusta
            || state.selection.is_some()
            || state.edit.on
            || state.recording.is_some()
            || self.due.is_some_and(|due| due <= now)
            || self.last.is_none_or(|last| now.duration_since(last) >= LIVE)
    }

    /// How long until it wants to run by itself.
    pub(super) fn delay(&self) -> Option<Duration> {
        if self.wanted {
            return Some(Duration::ZERO);
        }
        self.due.map(|due| due.saturating_duration_since(Instant::now()))
    }

    /// Runs it: takes input, lets `dt` seconds pass and lays everything out anew.
    pub(super) fn run(
        &mut self,
        window: &Window,
        size: [u32; 2],
        (state, model, info): (&mut State, &mut Model, &Info),
        dt: f64,
        latency: &mut Latency,
    ) -> Result<()> {
        let input = self.winit.take_egui_input(window);
        for file in &input.dropped_files {
            state.requests.extend(file.path.clone().map(|path| dropped(path, state.edit.on)));
        }
        let scale = f64::from(self.context.pixels_per_point());
        let Self { context, thrust, dragged, .. } = self;
        state.interacting = false;
        state.edit.frame = super::editing::mode::Frame { size, scale };
        state.age_messages();
        let messages = state.messages.len();
        let mut moved = Ok(());
        let output = context.run(input, |context| {
            panel::draw(context, state, info);
            labels::draw(context, state, !info.model.is_empty());
            egui::CentralPanel::default().frame(egui::Frame::NONE).show(context, |ui| {
                let area = ui.max_rect();
                let response = ui.interact(area, ui.id().with("scene"), egui::Sense::click_and_drag());
                *thrust = input::scene_input(ui, &response, state);
                *dragged = response.dragged() || context.is_using_pointer();
                state.view_center = [f64::from(area.center().x) * scale, f64::from(area.center().y) * scale];
                state.window_height = f64::from(size[1]);
                latency.applied(&Visible::of(state, *thrust));
                moved = advance(state, model, dt, *thrust);
                let camera = state.view(size);
                let projection = Projection::new(camera, state.navigator.pose.distance, 1.0 / scale);
                let painter = context.layer_painter(egui::LayerId::background()).with_clip_rect(area);
                overlay::draw(&painter, &projection, state, model);
                super::editing::overlay::draw(&painter, &projection, state);
            });
            if !state.messages.is_empty() {
                context.request_repaint_after(MESSAGES);
            }
        });
        let now = Instant::now();
        let delay = output.viewport_output.get(&egui::ViewportId::ROOT).map_or(Duration::MAX, |v| v.repaint_delay);
        self.due = (delay < NEVER).then(|| now + delay);
        self.last = Some(now);
        self.wanted = state.messages.len() != messages;
        self.runs += 1;
        self.pixels_per_point = output.pixels_per_point;
        self.primitives = self.context.tessellate(output.shapes, output.pixels_per_point);
        self.textures.append(output.textures_delta);
        self.winit.handle_platform_output(window, output.platform_output);
        moved
    }

    /// A frame without it: only time passes.
    pub(super) fn pass(&self, state: &mut State, model: &mut Model, dt: f64) -> Result<()> {
        state.interacting = self.dragged;
        advance(state, model, dt, self.thrust)
    }

    /// Keys that are held.
    pub(super) fn thrust(&self) -> Thrust {
        self.thrust
    }

    /// Shows a picture with the interface over it.
    pub(super) fn show(&mut self, presenter: &mut Presenter, picture: &Buffer) -> Result<Submission> {
        let textures = std::mem::take(&mut self.textures);
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
            self.primitives.iter().filter_map(|p| match &p.primitive {
                Primitive::Mesh(mesh) => Some(Mesh {
                    vertices: bytemuck::cast_slice(&mesh.vertices),
                    indices: &mesh.indices,
                    clip: [p.clip_rect.min.x, p.clip_rect.min.y, p.clip_rect.max.x, p.clip_rect.max.y],
                    texture: texture_id(mesh.texture_id),
                }),
                Primitive::Callback(_) => None,
            })
        };
        let overlay = Overlay { updates: &updates, forget: &forget, meshes, pixels_per_point: self.pixels_per_point };
        presenter.show(picture, overlay)
    }

    /// Pixels per point.
    pub(super) fn scale(&self) -> f32 {
        self.context.pixels_per_point()
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
    super::editing::follow::follow(state, model)
}

/// What is asked for with a file that was dropped: to open it, or to add it to what is edited.
fn dropped(path: std::path::PathBuf, editing: bool) -> Request {
    match super::editing::words::quoted(&path.display().to_string()).filter(|_| editing) {
        Some(name) => Request::Edit(Ask::Run(format!("merge {name}"))),
        None => Request::Open(path),
    }
}

fn texture_id(id: egui::TextureId) -> u64 {
    match id {
        egui::TextureId::Managed(n) => n << 1,
        egui::TextureId::User(n) => n << 1 | 1,
    }
}
