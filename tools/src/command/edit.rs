//! `spgs edit`: commands select Gaussians of a model and change them; the result is a model, with a list of the edits beside it.

use std::path::{Path, PathBuf};

use engine::edit::script::{Command, EditList, Place, ScriptError, parse};
use engine::edit::{BOUND_PX, Session, Step};
use engine::error::{Error, Result};
use engine::scene::{Camera, Scene};
use serde::Serialize;

use crate::cli::args::{EditArgs, Global};
use crate::cli::edited::Target;
use crate::cli::{model, output, progress};

/// Most bytes of a script.
const MOST_BYTES: u64 = 64 << 20;

/// What was done.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// The file read.
    pub input: PathBuf,
    /// The file written; absent in a dry run.
    pub output: Option<PathBuf>,
    /// The list of edits beside it.
    pub edits: Option<PathBuf>,
    /// Gaussians before and after.
    pub gaussians: [usize; 2],
    /// Superpoints before and after.
    pub superpoints: [usize; 2],
    /// Key times before and after.
    pub key_times: [usize; 2],
    /// The bound of re-made poses, pixels.
    pub bound_px: f64,
    /// What each command touched.
    pub steps: Vec<Step>,
    /// What the format of OUT cannot hold.
    pub dropped: Vec<String>,
}

/// A command, and what names its place in errors.
struct Sourced {
    command: Command,
    source: String,
}

/// What is to be done.
struct Plan {
    commands: Vec<Sourced>,
    cameras: Vec<Camera>,
    bound_px: f64,
}

/// Edits, and says what was touched.
///
/// # Errors
/// As [`edit`].
pub fn run(args: &EditArgs, global: &Global) -> Result<()> {
    let summary = edit(args, global)?;
    if args.json {
        return output::json(&summary);
    }
    if !global.quiet {
        lines(&summary).iter().for_each(|line| output::line(line));
    }
    Ok(())
}

/// Edits.
///
/// # Errors
/// Those of the script, with line and column; of its operations; of reading and writing. Then nothing is written.
pub fn edit(args: &EditArgs, global: &Global) -> Result<Summary> {
    let plan = plan(args)?;
    let target = if args.dry_run { None } else { args.output.as_deref().map(Target::new).transpose()? };
    let loaded = model::load(&args.input)?;
    let bar = progress::steps(plan.commands.len() as u64, global.quiet || args.json);
    let before = counts(&loaded.scene);
    let mut session = Session::new(loaded.scene, plan.cameras, plan.bound_px);
    let mut steps = Vec::with_capacity(plan.commands.len());
    for Sourced { command, source } in &plan.commands {
        bar.set_message(command.text.clone());
        steps.push(session.apply(command).map_err(|e| at(e, source, command))?);
        bar.inc(1);
    }
    session.finish();
    let after = counts(&session.scene);
    let mut dropped = Vec::new();
    if let Some(target) = &target {
        bar.set_message("writing");
        let cameras = session.cameras_used().to_vec();
        dropped = target.write(&mut session.scene, &steps, plan.bound_px, &cameras)?;
    }
    bar.finish_and_clear();
    let pair = |k: usize| [before[k], after[k]];
    Ok(Summary {
        input: args.input.clone(),
        output: target.as_ref().map(|t| t.model.clone()),
        edits: target.map(|t| t.list),
        gaussians: pair(0),
        superpoints: pair(1),
        key_times: pair(2),
        bound_px: plan.bound_px,
        steps,
        dropped,
    })
}

/// Everything that is read before the model.
fn plan(args: &EditArgs) -> Result<Plan> {
    let (mut commands, mut cameras, mut bound_px) = (Vec::new(), Vec::new(), BOUND_PX);
    if let Some(path) = &args.script {
        let (text, source) = (read(path)?, path.display().to_string());
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
            let list = EditList::parse(&text, path)?;
            (cameras, bound_px) = (list.cameras(), list.bound_px);
            for (i, edit) in list.edits.iter().enumerate() {
                let source = format!("{source}, edit {}", i + 1);
                commands.extend(sourced(&edit.command, &source, |e, source| e.named(source))?);
            }
        } else {
            let corrupt = |e: ScriptError, _: &str| {
                let Place { line, column } = e.place;
                Error::corrupt(path, format!("line {line}, column {column}"), e.found, e.expected)
            };
            commands.extend(sourced(&text, &source, corrupt)?);
        }
    }
    for text in &args.commands {
        commands.extend(sourced(text, "-e", |e, source| e.named(source))?);
    }
    if let Some(data) = &args.data {
        cameras = model::load_cameras(data, args.split.as_deref(), [None; 2])?.cameras;
    }
    Ok(Plan { commands, cameras, bound_px: args.bound.unwrap_or(bound_px) })
}

fn sourced(text: &str, source: &str, wrong: impl Fn(ScriptError, &str) -> Error) -> Result<Vec<Sourced>> {
    let commands = parse(text).map_err(|e| wrong(e, source))?;
    Ok(commands.into_iter().map(|command| Sourced { command, source: source.to_owned() }).collect())
}

fn read(path: &Path) -> Result<String> {
    let bytes = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?.len();
    if bytes > MOST_BYTES {
        return Err(Error::Limit { what: path.display().to_string(), need: bytes.into(), have: MOST_BYTES.into() });
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    String::from_utf8(bytes).map_err(|e| {
        let at = format!("byte {}", e.utf8_error().valid_up_to());
        Error::corrupt(path, at, "no UTF-8", "text")
    })
}

/// The same error with the place of its command.
fn at(error: Error, source: &str, command: &Command) -> Error {
    let Place { line, column } = command.place;
    let place = format!("{source}: line {line}, column {column} (`{}`)", command.text);
    Error::At { place, error: Box::new(error) }
}

/// Gaussians, superpoints, key times.
fn counts(scene: &Scene) -> [usize; 3] {
    [scene.gaussians.len(), scene.deformation.superpoint_count(), scene.deformation.key_times().len()]
}

/// For people.
fn lines(summary: &Summary) -> Vec<String> {
    let mut lines: Vec<String> = summary.steps.iter().map(line).collect();
    let [gaussians, superpoints, keys] =
        [summary.gaussians, summary.superpoints, summary.key_times].map(|[a, b]| format!("{a} → {b}"));
    lines.push(format!("{gaussians} Gaussians, {superpoints} superpoints, {keys} key times"));
    match (&summary.output, &summary.edits) {
        (Some(output), Some(edits)) => lines.push(format!("{}, edits in {}", output.display(), edits.display())),
        _ => lines.push("dry run: nothing is written".into()),
    }
    if !summary.dropped.is_empty() {
        lines.push(format!("left out: {}", summary.dropped.join("; ")));
    }
    lines
}

fn line(step: &Step) -> String {
    let touched = &step.touched;
    let mut line = format!("{}: {}", step.line, step.command);
    let is_selection = touched.gaussians == 0;
    line += &if is_selection {
        format!(": {} Gaussians selected", step.selected)
    } else {
        format!(": {} Gaussians, {} superpoints", touched.gaussians, touched.superpoints)
    };
    if touched.keys_added != 0 {
        line += &format!(", {:+} key times", touched.keys_added);
    }
    if let Some(px) = touched.error_px {
        line += &format!(", at most {px:.4} px off between key times");
    }
    touched.notes.iter().for_each(|note| line += &format!("; {note}"));
    line
}
