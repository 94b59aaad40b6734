//! What the user asked for, done between two frames.

use std::path::{Path, PathBuf};

use engine::error::Result;
use engine::file::picture::{self, Alpha};
use engine::image::Image;

use super::gui::Gui;
use super::program::Viewer;
use super::record::{Recording, free_name};
use super::state::{Request, Selection, Show, State};

impl Viewer {
    /// Does everything that was asked for; true when the picture changes with it.
    pub(super) fn do_requests(&mut self) -> Result<bool> {
        let requests = std::mem::take(&mut self.state.requests);
        // What a click selects is first in the next frame, and so in a picture that is asked for after it. The window may
        // have had no image for that frame.
        let mut waits = self.gui.as_ref().is_some_and(|gui| !gui.drew);
        let mut any = false;
        for request in requests {
            waits |= matches!(request, Request::Pick(..) | Request::Edit(_));
            if waits && request == Request::SavePng {
                self.state.requests.push(request);
                continue;
            }
            any = true;
            match request {
                Request::Open(path) => self.open(path),
                Request::Quit => self.state.wants_to_quit = true,
                Request::Edit(ask) => self.edit(ask)?,
                other => {
                    let Some(gui) = &mut self.gui else { continue };
                    act(other, gui, &mut self.state, &self.args.out)?;
                }
            }
        }
        Ok(any)
    }
}

fn act(request: Request, gui: &mut Gui, state: &mut State, folder: &Path) -> Result<()> {
    // What cannot be written is said in the window; the device's errors end the program.
    match request {
        Request::SavePng => {
            gui.finish(state)?;
            if !gui.complete || gui.is_reduced() {
                // The next frame has the room that this one lacked, and all pixels.
                gui.wants_full = true;
                state.requests.push(Request::SavePng);
                return Ok(());
            }
            let written = save_png(gui, folder);
            tell(state, written);
        }
        Request::SaveExr => {
            gui.finish(state)?;
            let image = exact_image(gui, state)?;
            let written =
                free_name(folder, "view", "exr").and_then(|path| picture::write_exr(&path, &image).map(|()| path));
            tell(state, written);
        }
        Request::ToggleRecording => match &gui.recording {
            Some(recording) => {
                let written = recording.write(folder);
                // What cannot be written is not thrown away.
                if written.is_ok() {
                    (gui.recording, state.recording) = (None, None);
                }
                tell(state, written);
            }
            None => {
                gui.recording = Some(Recording::default());
                state.recording = Some(0);
            }
        },
        Request::Pick(at, go) => {
            gui.finish(state)?;
            if !gui.complete {
                // Nothing lies under a click on a frame that lacked room: it takes the next one, which has it.
                state.requests.push(Request::Pick(at, go));
                return Ok(());
            }
            pick(gui, state, at, go)?;
        }
        Request::Open(_) | Request::Edit(_) | Request::Quit => {}
    }
    Ok(())
}

fn tell(state: &mut State, written: Result<PathBuf>) {
    match written {
        Ok(path) => state.say(format!("saved {}", path.display()), false),
        Err(error) => state.say(error.to_string(), true),
    }
}

/// What the window shows, without the interface.
fn save_png(gui: &Gui, folder: &Path) -> Result<PathBuf> {
    let path = free_name(folder, "view", "png")?;
    let Some((buffer, [width, height], bgra)) = gui.pixels() else {
        return Err(engine::error::Error::usage("image", "no frame yet", "a drawn scene"));
    };
    let bytes = gui.gpu.download(buffer.slice(0, 4 * u64::from(width) * u64::from(height)))?;
    let order = if bgra { [2, 1, 0] } else { [0, 1, 2] };
    let mut rgba = Vec::with_capacity(bytes.len());
    for pixel in bytes.chunks_exact(4) {
        for c in order {
            rgba.push(f32::from(pixel[c]) / 255.0);
        }
        rgba.push(1.0);
    }
    picture::write_png(&path, &Image { width, height, rgba, depth: Vec::new() }, Alpha::Drop)?;
    Ok(path)
}

/// The view as floats, with alpha and depth.
fn exact_image(gui: &mut Gui, state: &State) -> Result<Image> {
    let camera = state.view(gui.size());
    let renderer = gui.model.renderer(&gui.gpu, &state.settings, state.selection, 1.0)?;
    renderer.set_depth(true);
    let image = renderer.render(&camera, camera.time)?;
    renderer.set_depth(state.settings.show == Show::Depth);
    Ok(image)
}

/// Selects what lies under a point of the latest frame, which is finished, or goes to it.
fn pick(gui: &mut Gui, state: &mut State, at: [f32; 2], go: bool) -> Result<()> {
    let size = gui.size();
    let scale = gui.scale();
    let rendered = gui.info.rendered;
    let pixel = [0, 1].map(|k| (at[k] * scale * rendered[k] as f32 / size[k] as f32).max(0.0) as u32);
    let Some(picked) = gui.model.current().pick(pixel)? else {
        if state.selection.take().is_none() {
            // Nothing of it will be seen.
            gui.latency.rest();
        }
        gui.info.selected = None;
        return Ok(());
    };
    if go {
        let camera = state.view(size);
        let ray = glam::DVec3::new(
            (f64::from(at[0] * scale) - camera.cx) / camera.fx,
            (f64::from(at[1] * scale) - camera.cy) / camera.fy,
            1.0,
        );
        let target = camera.position + camera.rotation.transpose() * ray * f64::from(picked.depth);
        let distance = f64::from(picked.depth).max(1e-3);
        let pose = super::navigator::Pose { target, distance, ..state.navigator.pose };
        state.navigator.glide_to(pose);
        return Ok(());
    }
    let scene = &gui.model.scene;
    let index = picked.gaussian as usize;
    let superpoint = scene.deformation.superpoint_of_gaussian().get(index).copied();
    let count = scene.deformation.superpoint_of_gaussian().iter().filter(|g| Some(**g) == superpoint).count();
    let g = &scene.gaussians;
    let opacity = g.opacity_logit.get(index).map_or(0.0, |logit| 1.0 / (1.0 + (-logit).exp()));
    let scales = g.log_scale.get(index).map_or([0.0; 3], |s| s.map(f32::exp));
    gui.info.selected = Some((count, opacity, scales));
    state.selection = Some(Selection { picked, superpoint });
    Ok(())
}
