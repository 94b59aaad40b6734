//! An X server without a screen, and the program in it.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use clap::Parser as _;
use tools::cli::args::Cli;

const ARGUMENTS: &str = "SPGS_VIEWER_TEST_ARGUMENTS";
/// Longest that anything may take: validation layers on a busy machine are slow.
const PATIENCE: Duration = Duration::from_secs(120);

/// The body of `spgs`; does nothing in an ordinary test run.
#[test]
fn spgs_process() {
    let Ok(arguments) = std::env::var(ARGUMENTS) else { return };
    tools::viewer::ALLOCATIONS.set(allocations).unwrap();
    let code = tools::cli::output::run_main("spgs", move || {
        let cli = Cli::try_parse_from(std::iter::once("spgs").chain(arguments.lines())).unwrap();
        tools::command::run(&cli)
    });
    std::process::exit((0..=9).find(|&k| code == std::process::ExitCode::from(k)).unwrap_or(1).into());
}

/// `spgs` with these arguments as a process of its own, without any display.
pub fn spgs(arguments: &[&str]) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "desktop::spgs_process", "--nocapture", "--test-threads=1"]);
    command.env(ARGUMENTS, arguments.join("\n")).stdin(Stdio::null());
    if arguments.contains(&"--lose-device-at") {
        // The layer's experimental check between submissions crashes in vkDeviceWaitIdle of a device that is only said to be lost.
        command.env("VK_LAYER_ENABLES", "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT");
    }
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command
}

fn allocations() -> usize {
    let stats = crate::ALLOCATOR.stats();
    stats.allocations + stats.reallocations
}

/// An X server.
pub struct Desktop {
    server: Child,
    display: String,
}

impl Desktop {
    pub fn new(width: u32, height: u32) -> Self {
        // Without `-noreset` it starts anew, and refuses who comes then, whenever its last client goes.
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-noreset", "-nolisten", "tcp"])
            .args(["-screen", "0", &format!("{width}x{height}x24")])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb is installed by ci/setup --tests");
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { server, display: format!(":{}", line.trim()) }
    }

    /// Its name, for `DISPLAY`.
    pub fn display(&self) -> &str {
        &self.display
    }

    fn tool(&self, program: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new(program);
        command.args(arguments).env("DISPLAY", &self.display);
        command
    }

    /// Pixels of the whole screen, red, green, blue.
    pub fn capture(&self) -> Capture {
        let out = self.tool("xwd", &["-root", "-silent"]).output().expect("xwd is installed by ci/setup --tests");
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        Capture::of_xwd(&out.stdout)
    }
}

impl Drop for Desktop {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// A picture of the screen.
pub struct Capture {
    pub width: usize,
    pub rgb: Vec<[u8; 3]>,
}

impl Capture {
    /// The format of `xwd`: a header of big-endian words, a colour map, then rows of 32-bit pixels (blue first).
    fn of_xwd(bytes: &[u8]) -> Self {
        let word = |i: usize| u32::from_be_bytes(bytes[4 * i..4 * i + 4].try_into().unwrap()) as usize;
        let (header, width, height, bits, row, colors) = (word(0), word(4), word(5), word(11), word(12), word(19));
        assert_eq!((word(1), bits), (7, 32), "version and bits per pixel");
        let start = header + 12 * colors;
        let pixel = |x: usize, y: usize| {
            let p = &bytes[start + y * row + 4 * x..];
            [p[2], p[1], p[0]]
        };
        Self { width, rgb: (0..height).flat_map(|y| (0..width).map(move |x| pixel(x, y))).collect() }
    }

    /// Number of different colours in a rectangle.
    pub fn colors(&self, [x0, y0, x1, y1]: [usize; 4]) -> usize {
        let all = (y0..y1).flat_map(|y| (x0..x1).map(move |x| self.rgb[y * self.width + x]));
        all.collect::<std::collections::BTreeSet<_>>().len()
    }

    /// Number of pixels whose channels are within `most` of a colour.
    pub fn near(&self, color: [u8; 3], most: u8) -> usize {
        self.rgb.iter().filter(|p| p.iter().zip(color).all(|(a, b)| a.abs_diff(b) <= most)).count()
    }

    /// Keeps it for people to look at, when `SPGS_SCREENSHOTS` names a folder.
    pub fn keep(&self, name: &str) {
        let Some(folder) = std::env::var_os("SPGS_SCREENSHOTS") else { return };
        let (width, height) = (self.width as u32, (self.rgb.len() / self.width) as u32);
        let flat = self.rgb.iter().flatten().copied().collect();
        let picture = image::RgbImage::from_raw(width, height, flat).unwrap();
        picture.save(PathBuf::from(folder).join(format!("{name}.png"))).unwrap();
    }
}

/// The program and its window.
pub struct Window<'a> {
    pub desktop: &'a Desktop,
    child: Option<Child>,
    id: String,
    out: PathBuf,
    saved: u32,
}

impl<'a> Window<'a> {
    /// Opens a model and waits until it is shown.
    pub fn open(desktop: &'a Desktop, model: &Path, out: &Path, more: &[&str]) -> Self {
        let mut arguments = vec!["view", model.to_str().unwrap(), "--out", out.to_str().unwrap(), "--json"];
        arguments.extend(more);
        let child = spgs(&arguments)
            .env("DISPLAY", &desktop.display)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut window = Self { desktop, child: Some(child), id: String::new(), out: out.into(), saved: 0 };
        let name = model.file_name().unwrap().to_str().unwrap();
        window.wait("its window", |w| {
            let found = w.desktop.tool("xdotool", &["search", "--name", name]).output().unwrap();
            w.id = String::from_utf8_lossy(&found.stdout).lines().next().unwrap_or_default().to_owned();
            // It may not be on the screen yet.
            !w.id.is_empty() && w.desktop.tool("xdotool", &["windowfocus", &w.id]).output().unwrap().status.success()
        });
        window
    }

    /// Runs xdotool.
    pub fn tool(&self, arguments: &[&str]) {
        let out = self.desktop.tool("xdotool", arguments).output().expect("xdotool is installed by ci/setup --tests");
        assert!(out.status.success(), "xdotool {arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
    }

    /// Presses a key, by its X name.
    pub fn key(&self, name: &str) {
        self.tool(&["key", name]);
    }

    /// Drags with a button over some steps. Pictures in between see to it that not all of it falls into one frame, which
    /// may be slow.
    pub fn drag(&mut self, button: &str, from: [i32; 2], by: [i32; 2]) {
        self.tool(&["mousemove", &from[0].to_string(), &from[1].to_string(), "mousedown", button]);
        self.picture();
        for step in 1..=5 {
            let at = [0, 1].map(|k| (from[k] + by[k] * step / 5).to_string());
            self.tool(&["mousemove", &at[0], &at[1]]);
            std::thread::sleep(Duration::from_millis(40));
        }
        self.picture();
        self.tool(&["mouseup", button]);
    }

    pub fn resize(&self, width: u32, height: u32) {
        self.tool(&["windowsize", &self.id, &width.to_string(), &height.to_string()]);
    }

    pub fn id(&self) -> &str {
        &self.id
    }

    /// What stands above the window.
    pub fn title(&self) -> String {
        let out = self.desktop.tool("xdotool", &["getwindowname", &self.id]).output().unwrap();
        String::from_utf8_lossy(&out.stdout).trim().to_owned()
    }

    /// Waits until something is so; fails when the program has ended.
    pub fn wait(&mut self, what: &str, mut so: impl FnMut(&mut Self) -> bool) {
        let start = Instant::now();
        while !so(self) {
            if let Some(child) = &mut self.child
                && let Some(status) = child.try_wait().unwrap()
            {
                let out = self.child.take().unwrap().wait_with_output().unwrap();
                panic!("{what}: ended with {status}: {}", String::from_utf8_lossy(&out.stderr));
            }
            assert!(start.elapsed() < PATIENCE, "waited in vain for {what}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits for a file that the program writes.
    pub fn file(&mut self, name: &str) -> PathBuf {
        let path = self.out.join(name);
        let wanted = path.clone();
        self.wait(name, |_| wanted.exists());
        path
    }

    /// Saves the picture with the viewer's own key; what was pressed and dragged before is in it.
    pub fn picture(&mut self) -> image::RgbImage {
        self.saved += 1;
        self.key("F12");
        let path = self.file(&format!("view-{}.png", self.saved));
        image::open(path).unwrap().to_rgb8()
    }

    /// The picture once the panel, too, shows what was pressed and clicked before: it follows by a frame.
    pub fn settled(&mut self) -> image::RgbImage {
        self.picture();
        self.picture()
    }

    /// Clicks on what the window shows, with a key held unless it is empty; the picture once all follows.
    pub fn press(&mut self, held: &str, at: [i32; 2]) -> image::RgbImage {
        let [x, y] = at.map(|v| v.to_string());
        let click = ["mousemove", &x, &y, "click", "1"];
        match held {
            "" => self.tool(&click),
            _ => self.tool(&[&["keydown", held][..], &click, &["keyup", held]].concat()),
        }
        self.settled()
    }

    /// Ends the program with its key; what it measured.
    pub fn quit(mut self) -> serde_json::Value {
        self.key("ctrl+q");
        let out = self.child.take().unwrap().wait_with_output().unwrap();
        let (text, errors) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
        assert!(out.status.success(), "{errors}");
        assert!(!errors.contains("validation"), "{errors}");
        let json = &text[text.find('{').unwrap()..=text.rfind('}').unwrap()];
        serde_json::from_str(json).unwrap()
    }
}

impl Drop for Window<'_> {
    fn drop(&mut self) {
        let Some(mut child) = self.child.take() else { return };
        if std::thread::panicking() {
            self.desktop.capture().keep(&format!("failed-{}", std::process::id()));
        }
        let _ = child.kill();
        let Ok(out) = child.wait_with_output() else { return };
        if std::thread::panicking() {
            eprintln!("the window said: {}", String::from_utf8_lossy(&out.stderr));
        }
    }
}

/// Mean absolute difference of two pictures of one size, levels of 255.
pub fn difference(a: &image::RgbImage, b: &image::RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(x, y)| u64::from(x.abs_diff(*y))).sum();
    sum as f64 / a.as_raw().len() as f64
}
