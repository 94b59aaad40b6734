//! The program of the window: its events, and what it says at its end.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use engine::error::{Error, Result};
use engine::gpu::GpuOptions;
use serde_json::json;
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, KeyEvent, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{Window, WindowId};

use super::editing::editor::Editor;
use super::first::first_state;
use super::gui::{Gui, Next};
use super::load::{Extras, News, Opened};
use super::losses::Losses;
use super::navigator::Pose;
use super::state::State;
use super::turn::{Allocations, Turn};
use super::{input, load, statistics};
use crate::cli::args::{Global, ViewerArgs};
use crate::cli::{camera, gpu_session, output};

/// The program between two events.
pub(super) struct Viewer {
    pub(super) args: ViewerArgs,
    pub(super) options: GpuOptions,
    pub(super) proxy: EventLoopProxy<News>,
    /// Stops the thread that watches a folder.
    pub(super) watching: Option<Arc<AtomicBool>>,
    pub(super) state: State,
    pub(super) gui: Option<Gui>,
    pub(super) losses: Losses,
    /// Of devices that were lost.
    pub(super) validation_messages: Vec<String>,
    /// The model that was asked for last.
    pub(super) asked: Option<std::path::PathBuf>,
    /// What was edited, since the first time that the edit mode began.
    pub(super) editor: Option<Editor>,
    pub(super) turn: Turn,
    pub(super) drawn: u64,
    pub(super) opened_once: bool,
    pub(super) started: Instant,
    pub(super) error: Option<Error>,
}

/// Opens the window and runs until it is closed.
pub fn run(args: &ViewerArgs, global: &Global) -> Result<()> {
    if let Some(path) = &args.model {
        std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
    }
    let state = first_state(args)?;
    let no_display = |e: winit::error::EventLoopError| {
        log::debug!("{e}");
        let found = match std::env::var_os("DISPLAY") {
            None => "no display".to_owned(),
            Some(display) => format!("no window system that answers at {}", display.display()),
        };
        Error::usage("spgs view", found, "a graphical session (DISPLAY); images without one: spgs render")
    };
    let mut event_loop = EventLoop::<News>::with_user_event();
    #[cfg(target_os = "linux")]
    winit::platform::x11::EventLoopBuilderExtX11::with_any_thread(&mut event_loop, true);
    let event_loop = event_loop.build().map_err(no_display)?;
    let mut viewer = Viewer {
        options: gpu_session::options(global),
        proxy: event_loop.create_proxy(),
        watching: None,
        state,
        gui: None,
        losses: Losses::default(),
        validation_messages: Vec::new(),
        asked: None,
        editor: None,
        turn: Turn::default(),
        drawn: 0,
        opened_once: false,
        started: Instant::now(),
        error: None,
        args: args.clone(),
    };
    event_loop.run_app(&mut viewer).map_err(no_display)?;
    viewer.close()
}

impl Viewer {
    /// Starts to read a model; it is shown when it is there.
    pub(super) fn open(&mut self, path: std::path::PathBuf) {
        if let Some(stop) = self.watching.take() {
            stop.store(true, Ordering::Relaxed);
        }
        self.state.loading = Some(path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned());
        self.asked = Some(path.clone());
        // What is opened later has levels of its own.
        let is_first = self.args.model.as_ref() == Some(&path);
        let extras = Extras {
            level: self.args.level.filter(|_| is_first),
            confidence: self.args.confidence.clone().filter(|_| is_first),
            poses: self.args.poses.clone().filter(|_| is_first),
        };
        self.watching = Some(load::start(path, extras, self.proxy.clone()));
    }

    fn show(&mut self, opened: Opened) -> Result<()> {
        if opened.again && self.editor.is_some() {
            return Ok(());
        }
        match self.leave_editing() {
            Ok(None) => {}
            Ok(Some(list)) => self.state.say(format!("saved {}", list.display()), false),
            Err(error) => self.state.say(error.to_string(), true),
        }
        let Some(gui) = &mut self.gui else { return Ok(()) };
        self.state.loading = None;
        opened.messages.iter().for_each(|m| self.state.say(m.clone(), false));
        let (again, first) = (opened.again, !self.opened_once);
        if let (Some(background), true) = (opened.background, first) {
            self.state.settings.background = background;
        }
        gui.set_model(opened, &mut self.state)?;
        self.turn.count_anew();
        self.opened_once = true;
        if !again {
            self.place_camera(first);
        }
        self.started = Instant::now();
        Ok(())
    }

    /// The whole scene in view, or the first camera of the data set.
    fn place_camera(&mut self, first: bool) {
        let Some(gui) = &self.gui else { return };
        let camera = camera::default_camera(&gui.model.scene, gui.size());
        let state = &mut self.state;
        let pose = Pose::of_camera(&camera, (camera.position - state.extent.0).length());
        state.navigator.jump_to(pose);
        // The window may be wide: what fits its width need not fit its height.
        let framed = state.framing();
        state.navigator.jump_to(framed);
        if first && !state.cameras.is_empty() {
            state.go_to_camera(0);
            let pose = state.navigator.goal();
            state.navigator.jump_to(pose);
            state.timeline.playing = state.timeline.moves();
        } else if state.navigator.up != glam::DVec3::NEG_Y {
            // From the side and a little above.
            let up = state.navigator.up;
            let upright = state.navigator.looking(up.any_orthonormal_vector() - 0.25 * up);
            state.navigator.jump_to(upright);
        }
        if first {
            if let Some(time) = self.args.time {
                state.timeline.seek(time);
            }
            state.timeline.playing &= !self.args.pause;
        }
    }

    fn redraw(&mut self, event_loop: &ActiveEventLoop) {
        let Some(gui) = &mut self.gui else { return };
        self.turn.drew();
        let next = gui.frame(&mut self.state);
        let done = next.and_then(|next| {
            let more = self.do_requests()?;
            if more {
                self.gui.iter_mut().for_each(|g| g.interface.want());
            }
            Ok(if more { Next::Now } else { next })
        });
        match done {
            Ok(next) => {
                self.drawn += u64::from(self.opened_once || self.asked.is_none());
                self.schedule(next, event_loop);
            }
            Err(error) => self.fail(error, event_loop),
        }
    }

    /// A frame with the interface as it is now.
    pub(super) fn redraw_all(&mut self) {
        if let Some(gui) = &mut self.gui {
            gui.interface.want();
            gui.window.request_redraw();
        }
    }

    fn schedule(&mut self, next: Next, event_loop: &ActiveEventLoop) {
        if self.args.frames.is_some_and(|n| self.drawn >= n) || self.state.wants_to_quit {
            event_loop.exit();
            return;
        }
        self.turn.draw_again(next == Next::Now);
        event_loop.set_control_flow(match next {
            Next::After(delay) => ControlFlow::WaitUntil(Instant::now() + delay),
            Next::WhenAsked => ControlFlow::Wait,
            Next::Now => ControlFlow::Poll,
        });
    }

    /// Ends the program, unless the device was lost and there is another one.
    fn fail(&mut self, error: Error, event_loop: &ActiveEventLoop) {
        let error = match error {
            lost @ Error::DeviceLost { .. } => match self.recover(lost) {
                Ok(()) => return,
                Err(error) => error,
            },
            other => other,
        };
        self.error.get_or_insert(error);
        event_loop.exit();
    }

    /// What the program says at its end.
    fn close(mut self) -> Result<()> {
        if let Some(stop) = &self.watching {
            stop.store(true, Ordering::Relaxed);
        }
        let statistics = &self.state.statistics;
        let measured = (statistics.fps(), statistics.low_fps(), self.state.frame);
        let (mut device, mut rendered) = (None, [0; 2]);
        let (mut input, mut interface_frames, mut resizes) = (None, 0, 0);
        match self.leave_editing() {
            Ok(None) => {}
            Ok(Some(list)) => {
                output::error_line(&format!("spgs: saved {}: edits that were in no file", list.display()))
            }
            Err(error) => self.error = self.error.or(Some(error)),
        }
        let allocations = self.turn.allocations();
        let mut all = std::mem::take(&mut self.validation_messages);
        if let Some(mut gui) = self.gui.take() {
            // A path that is still recorded is not thrown away.
            if let Some(recording) = gui.recording.take().filter(|r| r.len() > 0) {
                match recording.write(&self.args.out) {
                    Ok(path) => output::error_line(&format!("spgs: saved {}", path.display())),
                    Err(error) => self.error = self.error.or(Some(error)),
                }
            }
            let gpu = gui.gpu.clone();
            rendered = gui.info.rendered;
            (input, interface_frames, resizes) = (gui.latency.measured(), gui.interface.runs, gui.resizes);
            drop(gui);
            device = Some(gpu.info().name.clone());
            all.extend(gpu.take_validation_messages());
        }
        all.iter().for_each(|m| log::warn!("validation layer: {m}"));
        if let Some(error) = self.error {
            return Err(error);
        }
        if self.args.json {
            let (fps, low, frame) = measured;
            let mut report = json!({
                "device": device,
                "frames": self.drawn,
                "interface_frames": interface_frames,
                "resizes": resizes,
                "device_losses": self.losses.count,
                "seconds": self.started.elapsed().as_secs_f64(),
                "fps": fps,
                "fps_low_1_percent": low,
                "resolution": rendered,
                "visible": frame.visible,
                "instances": frame.instances,
                "stages_ms": statistics::STAGES.iter().zip(self.state.statistics.mean_stages()).collect::<std::collections::BTreeMap<_, _>>(),
                "input_to_photon": input.map(|m| json!({
                    "events": m.events,
                    "frames_median": m.frames[0],
                    "frames_max": m.frames[1],
                    "ms_median": m.ms[0],
                    "ms_max": m.ms[1],
                })),
                "validation_messages": all.len(),
            });
            if let Some(counted) = allocations {
                let Allocations { frames, allocating, allocations } = counted;
                report["allocations_between_interface_frames"] =
                    json!({ "frames": frames, "allocating_frames": allocating, "allocations": allocations });
            }
            return output::json(&report);
        }
        Ok(())
    }
}

impl ApplicationHandler<News> for Viewer {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.gui.is_some() {
            return;
        }
        let [width, height] = self.args.size;
        let attributes =
            Window::default_attributes().with_title("spgs").with_inner_size(PhysicalSize::new(width, height));
        let window = event_loop.create_window(attributes).map_err(|e| {
            Error::usage(
                "spgs view",
                format!("no window ({})", output::one_line(&e.to_string())),
                "a graphical session",
            )
        });
        if let Err(error) = window.and_then(|w| self.make_gui(Arc::new(w))) {
            return self.fail(error, event_loop);
        }
        if let Some(path) = self.args.model.clone() {
            self.open(path);
        }
        self.gui.iter().for_each(|g| g.window.request_redraw());
    }

    fn user_event(&mut self, event_loop: &ActiveEventLoop, news: News) {
        self.turn.event();
        let result = match news {
            News::Opened(opened) => self.show(*opened),
            News::Failed(path, error) if self.opened_once || self.args.model.as_ref() != Some(&path) => {
                self.state.loading = None;
                self.state.say(error.to_string(), true);
                Ok(())
            }
            News::Failed(_, error) => Err(error),
        };
        if let Err(error) = result {
            self.fail(error, event_loop);
        }
        self.redraw_all();
    }

    fn new_events(&mut self, _: &ActiveEventLoop, cause: winit::event::StartCause) {
        self.turn.begin();
        if let winit::event::StartCause::ResumeTimeReached { .. } = cause {
            self.gui.iter().for_each(|g| g.window.request_redraw());
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if self.turn.is_due() && !event_loop.exiting() {
            self.redraw(event_loop);
        }
        self.turn.end(self.gui.as_ref().map_or(0, |g| g.interface.runs));
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        if event != WindowEvent::RedrawRequested {
            self.turn.event();
        }
        if let Some(Err(error)) = self.gui.as_mut().map(|g| g.event(&event)) {
            return self.fail(error, event_loop);
        }
        match &event {
            WindowEvent::CloseRequested => return event_loop.exit(),
            WindowEvent::RedrawRequested => return self.redraw(event_loop),
            WindowEvent::KeyboardInput { event, .. }
                if !self.gui.as_ref().is_some_and(|g| g.interface.wants_keyboard())
                    && special_key(event, &mut self.state) =>
            {
                self.redraw_all();
                return;
            }
            _ => {}
        }
        let Some(gui) = &mut self.gui else { return };
        if matches!(event, WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } | WindowEvent::Occluded(_))
        {
            gui.resized();
            gui.interface.want();
            gui.window.request_redraw();
        }
        if gui.interface.event(&gui.window, &event) {
            gui.window.request_redraw();
        }
    }
}

/// Keys that egui keeps for itself or does not tell apart: Tab and those of the numpad.
fn special_key(event: &KeyEvent, state: &mut State) -> bool {
    let PhysicalKey::Code(code) = event.physical_key else { return false };
    let numpad = match code {
        // Numbers may be typed.
        _ if state.edit.gesture.is_some() => return false,
        KeyCode::Tab => 0,
        KeyCode::Numpad1 => 1,
        KeyCode::Numpad3 => 3,
        KeyCode::Numpad7 => 7,
        KeyCode::Numpad9 => 9,
        _ => return false,
    };
    if event.state == ElementState::Pressed && !event.repeat {
        match numpad {
            0 => input::press(egui::Key::Tab, egui::Modifiers::NONE, state),
            n => input::numpad(n, state),
        }
    }
    true
}
