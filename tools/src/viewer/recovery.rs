//! A device that is lost (a driver that starts anew, a card that is pulled out): the window goes on with another one.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use engine::error::{Error, Result};
use engine::scene::Scene;
use winit::window::Window;

use super::gui::Gui;
use super::latency::Latency;
use super::load::Opened;
use super::model::Expected;
use super::program::Viewer;
use super::record::Recording;

/// How often, and after which pauses, another device is asked for: a driver takes a moment to be back.
const TRIES: u32 = 10;
const PAUSE: Duration = Duration::from_millis(300);

/// What a window shows that is not on the device.
struct Shown {
    /// Empty when the model was on its way to the device.
    path: PathBuf,
    scene: Arc<Scene>,
    expected: Option<Arc<Expected>>,
}

/// What goes on from one device to the next.
#[derive(Default)]
struct Kept {
    recording: Option<Recording>,
    latency: Latency,
    interface_runs: u64,
    resizes: u64,
}

impl Kept {
    fn of(gui: &mut Gui) -> Self {
        Self {
            recording: gui.recording.take(),
            latency: std::mem::take(&mut gui.latency).with_nothing_waiting(),
            interface_runs: gui.interface.runs,
            resizes: gui.resizes,
        }
    }

    fn give(self, gui: &mut Gui) {
        (gui.recording, gui.latency) = (self.recording, self.latency);
        (gui.interface.runs, gui.resizes) = (self.interface_runs, self.resizes);
    }
}

impl Viewer {
    /// Shows the same on another device, after this `error`, which is given back when there were too many or there is none.
    /// A device that is lost while the scene comes to it counts like any other.
    pub(super) fn recover(&mut self, mut error: Error) -> Result<()> {
        let Some(mut gui) = self.gui.take() else { return Err(error) };
        let window = Arc::clone(&gui.window);
        let path = std::mem::take(&mut gui.model.path);
        let shown = Shown { path, scene: Arc::clone(&gui.model.scene), expected: gui.model.expected() };
        let mut kept = self.let_go(gui);
        loop {
            if !self.losses.note(Instant::now()) {
                return Err(error);
            }
            log::warn!("{error}; another device is opened");
            self.make_gui_in_time(&window)?;
            match self.show_again(&shown, kept) {
                Err(lost @ Error::DeviceLost { .. }) => error = lost,
                other => {
                    other?;
                    break;
                }
            }
            let Some(gui) = self.gui.take() else { return Err(error) };
            kept = self.let_go(gui);
        }
        self.state.say(format!("{error}: shown on another device"), true);
        self.redraw_all();
        Ok(())
    }

    /// Frees a device: a window has one swapchain at a time.
    fn let_go(&mut self, mut gui: Gui) -> Kept {
        let (gpu, kept) = (gui.gpu.clone(), Kept::of(&mut gui));
        drop(gui);
        self.validation_messages.extend(gpu.take_validation_messages());
        kept
    }

    fn make_gui_in_time(&mut self, window: &Arc<Window>) -> Result<()> {
        let mut tries = 0;
        while let Err(error) = self.make_gui(Arc::clone(window)) {
            tries += 1;
            if tries == TRIES {
                return Err(error);
            }
            std::thread::sleep(PAUSE);
        }
        Ok(())
    }

    fn show_again(&mut self, shown: &Shown, kept: Kept) -> Result<()> {
        let Some(gui) = &mut self.gui else { return Ok(()) };
        kept.give(gui);
        // Lost while it came to the device for the first time: it is read once more.
        if shown.path.as_os_str().is_empty() {
            if let Some(path) = self.asked.clone() {
                self.open(path);
            }
            return Ok(());
        }
        let (selection, editor) = (self.state.selection, self.editor.take());
        let (path, scene) = (shown.path.clone(), Arc::clone(&shown.scene));
        let opened = Opened {
            path,
            scene,
            expected: shown.expected.clone(),
            poses: self.state.poses.clone(),
            messages: Vec::new(),
            background: None,
            again: true,
        };
        let done = gui.set_model(opened, &mut self.state);
        (self.state.selection, self.editor) = (selection, editor);
        done?;
        self.show_edits(false)
    }

    /// The window's device and everything on it.
    pub(super) fn make_gui(&mut self, window: Arc<Window>) -> Result<()> {
        let gui = Gui::new(window, &self.options, &self.state)?;
        if let Some(submission) = self.args.lose_device_at.get(self.losses.count) {
            gui.gpu.inject_device_lost(*submission);
        }
        self.gui = Some(gui);
        Ok(())
    }
}
