//! Video: raw frames are piped to an encoder that is installed; the file appears whole or not at all.

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use engine::error::{Error, Result};
use engine::file::picture::to_u8;
use engine::image::Image;
use tempfile::TempPath;

use super::plan::Picture;

/// The encoder's program.
const ENCODER: &str = "ffmpeg";
/// Longest message of the encoder that is passed on, bytes.
const MAX_MESSAGE: usize = 600;

/// An encoder at work.
#[derive(Debug)]
pub(super) struct Encoder {
    child: Child,
    input: Option<ChildStdin>,
    messages: Option<JoinHandle<String>>,
    size: [u32; 2],
    row: Vec<u8>,
    unfinished: Option<TempPath>,
    path: PathBuf,
}

/// The encoder's program, when it is on `PATH`.
pub(super) fn encoder() -> Option<PathBuf> {
    let folders = std::env::var_os("PATH")?;
    std::env::split_paths(&folders).map(|f| f.join(ENCODER)).find(|p| is_program(p))
}

fn is_program(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        std::fs::metadata(path).is_ok_and(|m| m.is_file() && m.permissions().mode() & 0o111 != 0)
    }
    #[cfg(not(unix))]
    path.with_extension("exe").is_file()
}

/// Refuses a path that no video can be at.
pub(super) fn check(path: &Path) -> Result<()> {
    if path.extension().is_none() {
        let found = path.display().to_string();
        return Err(Error::usage("--video", found, "a file name with an extension: .mp4, .mkv, .webm"));
    }
    if path.is_dir() {
        return Err(Error::usage("--video", format!("{} is a folder", path.display()), "a file name"));
    }
    Ok(())
}

/// Refuses pictures of several sizes.
pub(super) fn one_size(pictures: &[Picture]) -> Result<()> {
    let size = |p: &Picture| p.views.first().map(|(camera, _)| [camera.width, camera.height]);
    let Some(first) = pictures.first().and_then(size) else { return Ok(()) };
    match pictures.iter().filter_map(size).find(|s| *s != first) {
        None => Ok(()),
        Some([width, height]) => Err(Error::usage(
            "size of the video",
            format!("views of {}x{} and of {width}x{height}", first[0], first[1]),
            "one size: --width W --height H",
        )),
    }
}

impl Encoder {
    /// Starts `program` for frames of `size` pixels. The encoder chooses the codec by the extension; sides are made even,
    /// which most codecs need.
    pub(super) fn start(program: &Path, path: &Path, size: [u32; 2], fps: f64) -> Result<Self> {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let extension = path.extension().unwrap_or_default().to_string_lossy();
        let unfinished = tempfile::Builder::new()
            .prefix(".unfinished-")
            .suffix(&format!(".{extension}"))
            .tempfile_in(folder)
            .map_err(|e| Error::io(path, "create a temporary file beside it", e))?
            .into_temp_path();
        let [width, height] = size;
        let mut child = Command::new(program)
            .args(["-hide_banner", "-loglevel", "error", "-nostdin", "-y"])
            .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", &format!("{width}x{height}")])
            .args(["-framerate", &fps.to_string(), "-i", "pipe:0"])
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .arg(&*unfinished)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| Error::io(program, "start", e))?;
        let (input, mut errors) = (child.stdin.take(), child.stderr.take());
        // Read beside the writing, so that neither side waits for the other.
        let messages = std::thread::spawn(move || {
            let mut text = String::new();
            if let Some(errors) = &mut errors {
                let mut bytes = Vec::new();
                let _ = errors.read_to_end(&mut bytes);
                text = String::from_utf8_lossy(&bytes[..bytes.len().min(MAX_MESSAGE)]).into_owned();
            }
            text
        });
        let (messages, unfinished, path) = (Some(messages), Some(unfinished), path.to_owned());
        Ok(Self { child, input, messages, size, row: Vec::new(), unfinished, path })
    }

    /// Adds a frame: clamped and rounded to 8 bits, without alpha.
    pub(super) fn add(&mut self, image: &Image) -> Result<()> {
        if [image.width, image.height] != self.size {
            let found = format!("{}x{}", image.width, image.height);
            return Err(Error::usage("video frame", found, format!("{}x{}, as the first", self.size[0], self.size[1])));
        }
        self.row.clear();
        self.row.extend(image.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(to_u8));
        let written = self.input.as_mut().map(|input| input.write_all(&self.row));
        match written {
            Some(Ok(())) => Ok(()),
            // The encoder went away; what it said is the reason.
            _ => Err(self.failure()),
        }
    }

    /// Ends the video and puts it in its place.
    pub(super) fn finish(mut self) -> Result<()> {
        drop(self.input.take());
        let status = self.child.wait().map_err(|e| Error::io(&self.path, "wait for the encoder", e))?;
        let Some(unfinished) = self.unfinished.take() else { return Ok(()) };
        let bytes = std::fs::metadata(&unfinished).map_or(0, |m| m.len());
        if !status.success() || bytes == 0 {
            return Err(self.failure());
        }
        // Flushing needs the right to write on Windows.
        let synced = std::fs::File::options().write(true).open(&unfinished).and_then(|f| f.sync_all());
        synced.map_err(|e| Error::io(&self.path, "fsync", e))?;
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            // A temporary file is the owner's alone; a picture beside it is not.
            let _ = std::fs::set_permissions(&unfinished, std::fs::Permissions::from_mode(0o644));
        }
        unfinished.persist(&self.path).map_err(|e| Error::io(&self.path, "rename", e.error))
    }

    fn failure(&mut self) -> Error {
        drop(self.input.take());
        let _ = self.child.kill();
        let status = self.child.wait().map_or_else(|e| e.to_string(), |s| s.to_string());
        let text = self.messages.take().and_then(|m| m.join().ok()).unwrap_or_default();
        let text = if text.trim().is_empty() { status } else { format!("{}: {status}", text.trim()) };
        Error::io(&self.path, "encode with ffmpeg", std::io::Error::other(text))
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        drop(self.input.take());
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
