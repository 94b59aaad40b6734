//! Words to commands.

use glam::{DMat3, DVec3};

use super::reader::{Reader, color, commands, coordinates, factors, linear, number, numbers, ranges, span};
use super::{Action, Change, Command, Frame, Mark, Mode, Pivot, Retime, ScriptError, Term};
use crate::edit::select::{Criterion, Depth, Likeness};
use crate::edit::{Recolor, Window};
use crate::scene::Camera;

const COMMANDS: &str = "select, add, subtract, intersect, invert, grow, name, hide, isolate, show, lock, unlock, move, rotate, \
                        scale, delete, keep, duplicate, recolor, freeze, time, merge or camera";
const TERMS: &str =
    "all, none, superpoints, gaussians, sphere, box, click, rect, lasso, opacity, size, color, floaters or named";

/// The commands of a script.
///
/// # Errors
/// The first mistake.
pub fn parse(script: &str) -> Result<Vec<Command>, ScriptError> {
    let command = |words: Vec<super::reader::Word>| {
        let mut reader = Reader::new(&words);
        let action = action(&mut reader)?;
        if !reader.is_done() {
            return Err(reader.mistake("the end of the command"));
        }
        let text: Vec<&str> = words.iter().map(|word| word.raw.as_str()).collect();
        Ok(Command { place: words[0].place, text: text.join(" "), action })
    };
    commands(script)?.into_iter().map(command).collect()
}

fn action(reader: &mut Reader<'_>) -> Result<Action, ScriptError> {
    let word = reader.one_of(COMMANDS)?;
    Ok(match word {
        "add" => selection(reader, Mode::Add)?,
        "subtract" => selection(reader, Mode::Subtract)?,
        "intersect" => selection(reader, Mode::Intersect)?,
        "invert" => Action::Invert,
        "grow" => {
            let distance = positive(reader, "a distance above 0, world units")?;
            Action::Grow(distance, time(reader)?)
        }
        "name" => Action::Name(reader.word("a name")?.to_owned()),
        "hide" => Action::Mark(Mark::Hide(named(reader)?)),
        "isolate" => Action::Mark(Mark::Isolate),
        "show" => Action::Mark(Mark::Show(named(reader)?)),
        "lock" => Action::Mark(Mark::Lock(named(reader)?)),
        "unlock" => Action::Mark(Mark::Unlock(named(reader)?)),
        "move" => change(reader, "move")?,
        "rotate" => change(reader, "rotate")?,
        "scale" => change(reader, "scale")?,
        "delete" => Action::Delete,
        "keep" => Action::Keep,
        "duplicate" => Action::Duplicate,
        "recolor" => recolor(reader)?,
        "freeze" => Action::Retime(Retime::Freeze(reader.number("a time")?)),
        "time" => retime(reader)?,
        "merge" => merge(reader)?,
        "camera" => camera(reader)?,
        _ => selection(reader, Mode::Replace)?,
    })
}

fn positive(reader: &mut Reader<'_>, expected: &str) -> Result<f64, ScriptError> {
    reader.value(expected, |text| number(text).filter(|v| *v > 0.0))
}

fn time(reader: &mut Reader<'_>) -> Result<Option<f64>, ScriptError> {
    if reader.takes("time") { reader.number("a time").map(Some) } else { Ok(None) }
}

fn named(reader: &mut Reader<'_>) -> Result<Option<String>, ScriptError> {
    if reader.takes("named") { reader.word("a name").map(|name| Some(name.to_owned())) } else { Ok(None) }
}

fn selection(reader: &mut Reader<'_>, mode: Mode) -> Result<Action, ScriptError> {
    let term = term(reader)?;
    let is_pick = term.is_pick();
    let (mut depth, mut view, mut at, mut similar) = (Depth::Surface, None, None, None);
    while !reader.is_done() {
        if reader.takes("time") {
            at = Some(reader.number("a time")?);
        } else if reader.takes("similar") {
            similar = Some(reader.value("a distance, as 1.5px or 0.01 (world units)", likeness)?);
        } else if is_pick && reader.takes("view") {
            view = Some(reader.value("the number of a view", |text| text.parse().ok())?);
        } else if is_pick && reader.takes("through") {
            depth = Depth::Behind(f64::INFINITY);
        } else if is_pick && reader.takes("depth") {
            depth = Depth::Behind(positive(reader, "a depth above 0, world units")?);
        } else {
            let of_picks = if is_pick { "view, through, depth, " } else { "" };
            return Err(reader.mistake(format!("{of_picks}time, similar or the end of the command")));
        }
    }
    Ok(Action::Select { mode, term, depth, view, time: at, similar })
}

fn likeness(text: &str) -> Option<Likeness> {
    let above = |v: &f64| *v > 0.0;
    match text.strip_suffix("px") {
        Some(pixels) => number(pixels).filter(above).map(Likeness::Pixels),
        None => number(text).filter(above).map(Likeness::World),
    }
}

fn term(reader: &mut Reader<'_>) -> Result<Term, ScriptError> {
    let word = reader.one_of(TERMS)?;
    const LIST: &str = "numbers, as 3,7-12";
    Ok(Term::Criterion(match word {
        "superpoints" => Criterion::Superpoints(reader.value(LIST, ranges)?),
        "gaussians" => Criterion::Gaussians(reader.value(LIST, ranges)?),
        "sphere" => {
            let center = reader.vector("a centre x,y,z")?;
            Criterion::Sphere(center, positive(reader, "a radius above 0")?)
        }
        "box" => {
            let [a, b] = [reader.vector("a corner x,y,z")?, reader.vector("the other corner x,y,z")?];
            Criterion::Box(a.min(b), a.max(b))
        }
        "opacity" => Criterion::Opacity(limits(reader)?),
        "size" => Criterion::Size(limits(reader)?),
        "color" => {
            let color = reader.value("a colour, as #ff8800", color)?;
            let within = if reader.takes("within") { positive(reader, "a distance above 0")? } else { 0.2 };
            Criterion::Color(color, within)
        }
        "floaters" => Criterion::Floaters(positive(reader, "a distance from the cameras above 0")?),
        "click" => return Ok(Term::Click(reader.value("a pixel x,y (or 50%,50%)", coordinates)?)),
        "rect" => return Ok(Term::Rectangle(reader.value("corners x0,y0,x1,y1, pixels", numbers)?)),
        "lasso" => return lasso(reader),
        "named" => return Ok(Term::Named(reader.word("a name")?.to_owned())),
        "none" => return Ok(Term::None),
        _ => Criterion::All,
    }))
}

fn lasso(reader: &mut Reader<'_>) -> Result<Term, ScriptError> {
    const POINT: &str = "at least three pixels x,y";
    let mut points = vec![reader.value(POINT, numbers)?, reader.value(POINT, numbers)?, reader.value(POINT, numbers)?];
    while let Ok(point) = reader.value(POINT, numbers) {
        points.push(point);
    }
    Ok(Term::Lasso(points))
}

fn limits(reader: &mut Reader<'_>) -> Result<[f64; 2], ScriptError> {
    if reader.takes("below") {
        return Ok([f64::NEG_INFINITY, reader.number("a number")?]);
    }
    if reader.takes("above") {
        return Ok([reader.number("a number")?, f64::INFINITY]);
    }
    reader.value("below, above or a range, as 0.1..0.5", span)
}

fn change(reader: &mut Reader<'_>, word: &str) -> Result<Action, ScriptError> {
    let change = match word {
        "move" => Change::Move(reader.vector("a vector x,y,z")?),
        "rotate" => {
            let axis = axis(reader)?;
            Change::Rotate(axis, reader.number("an angle in degrees")?.to_radians())
        }
        _ => {
            let above = |v: &DVec3| v.min_element() > 0.0;
            Change::Scale(reader.value("a factor above 0, or three", |text| factors(text).filter(above))?)
        }
    };
    let (mut pivot, mut frame, mut at, mut during) = (Pivot::Center, Frame::World, None, None);
    while !reader.is_done() {
        if reader.takes("pivot") {
            pivot = reader.value("center, origin or a point x,y,z", |text| match text {
                "center" => Some(Pivot::Center),
                "origin" => Some(Pivot::Point(DVec3::ZERO)),
                text => numbers(text).map(|p| Pivot::Point(DVec3::from_array(p))),
            })?;
        } else if reader.takes("frame") {
            frame = if reader.takes("superpoint") {
                Frame::Superpoint(reader.value("the number of a superpoint", |text| text.parse().ok())?)
            } else {
                reader.value("world, part or superpoint", |text| match text {
                    "world" => Some(Frame::World),
                    "part" => Some(Frame::Part),
                    _ => None,
                })?
            };
        } else if reader.takes("time") {
            at = Some(reader.number("a time")?);
        } else if frame == Frame::World && reader.takes("during") {
            let [from, to] = reader.value("times, as 0.2..0.5", |text| span(text).filter(|[a, b]| a <= b))?;
            let ease = if reader.takes("ease") { positive(reader, "a time above 0")? } else { 0.1 };
            during = Some(Window { from, to, ease });
        } else {
            return Err(reader.mistake("pivot, frame, time, during (in the world's frame) or the end of the command"));
        }
    }
    if during.is_some() && frame != Frame::World {
        return Err(reader.mistake("the world's frame beside during"));
    }
    Ok(Action::Change { change, pivot, frame, time: at, during })
}

fn axis(reader: &mut Reader<'_>) -> Result<DVec3, ScriptError> {
    reader.value("an axis: x, y, z or a vector x,y,z", |text| match text {
        "x" => Some(DVec3::X),
        "y" => Some(DVec3::Y),
        "z" => Some(DVec3::Z),
        text => numbers(text).map(DVec3::from_array).filter(|axis| axis.try_normalize().is_some()),
    })
}

fn recolor(reader: &mut Reader<'_>) -> Result<Action, ScriptError> {
    let mut change = Recolor { matrix: DMat3::IDENTITY, offset: DVec3::ZERO };
    loop {
        if reader.takes("tint") {
            change.matrix = Recolor::tint(reader.value("a colour, as #ff8800", color)?).matrix * change.matrix;
        } else if reader.takes("matrix") {
            let rows = reader.value("nine numbers with commas, row by row", numbers::<9>)?;
            change.matrix = DMat3::from_cols_array(&rows).transpose() * change.matrix;
        } else if reader.takes("gain") {
            change.matrix = DMat3::from_diagonal(reader.value("a factor, or three", factors)?) * change.matrix;
        } else if reader.takes("offset") {
            change.offset += reader.vector("an offset r,g,b")?;
        } else {
            return Err(reader.mistake("tint, matrix, gain or offset"));
        }
        if reader.is_done() {
            return Ok(Action::Recolor(change));
        }
    }
}

fn retime(reader: &mut Reader<'_>) -> Result<Action, ScriptError> {
    Ok(Action::Retime(match reader.one_of("shift, stretch, reverse or loop")? {
        "shift" => Retime::Shift(reader.number("a time")?),
        "stretch" => Retime::Stretch(positive(reader, "a factor above 0")?),
        "reverse" => Retime::Reverse,
        _ => {
            let [from, to] = reader.value("times, as 0..0.5", |text| span(text).filter(|[a, b]| a < b))?;
            Retime::Loop(from, to)
        }
    }))
}

fn merge(reader: &mut Reader<'_>) -> Result<Action, ScriptError> {
    let file = reader.word("a model file")?.to_owned();
    let (mut at, mut rotate, mut scale, mut time) = (DVec3::ZERO, (DVec3::Z, 0.0), 1.0, [0.0, 1.0]);
    while !reader.is_done() {
        if reader.takes("at") {
            at = reader.vector("a place x,y,z")?;
        } else if reader.takes("rotate") {
            let axis = axis(reader)?;
            rotate = (axis, reader.number("an angle in degrees")?.to_radians());
        } else if reader.takes("scale") {
            scale = positive(reader, "a factor above 0")?;
        } else if reader.takes("time") {
            time = reader.value("a time in t, as 0.25+0.5t", linear)?;
        } else {
            return Err(reader.mistake("at, rotate, scale, time or the end of the command"));
        }
    }
    Ok(Action::Merge { file, at, rotate, scale, time })
}

fn camera(reader: &mut Reader<'_>) -> Result<Action, ScriptError> {
    let (mut eye, mut target, mut up, mut fov, mut size) = (None, None, DVec3::Z, 45.0, [800_u32; 2]);
    let (mut center, mut time) = (None, None);
    while !reader.is_done() {
        if reader.takes("eye") {
            eye = Some(reader.vector("a place x,y,z")?);
        } else if reader.takes("target") {
            target = Some(reader.vector("a place x,y,z")?);
        } else if reader.takes("up") {
            up = reader.vector("a direction x,y,z")?;
        } else if reader.takes("fov") {
            fov = reader.value("degrees, above 0 and below 180", |t| number(t).filter(|v| *v > 0.0 && *v < 180.0))?;
        } else if reader.takes("size") {
            let side = |v: f64| (v.fract() == 0.0 && (1.0..=16_384.0).contains(&v)).then_some(v as u32);
            size = reader.value("pixels w,h, 1 to 16384", |t| {
                let [w, h] = numbers(t)?;
                Some([side(w)?, side(h)?])
            })?;
        } else if reader.takes("center") {
            center = Some(reader.value("the pixel x,y that is looked at", numbers)?);
        } else if reader.takes("time") {
            time = Some(reader.number("a time")?);
        } else {
            return Err(reader.mistake("eye, target, up, fov, size, center, time or the end of the command"));
        }
    }
    let (Some(eye), Some(target)) = (eye, target) else { return Err(reader.mistake("eye x,y,z and target x,y,z")) };
    let camera = Camera::look_at(eye, target, up, fov.to_radians(), size);
    let [cx, cy] = center.unwrap_or([camera.cx, camera.cy]);
    Ok(Action::Camera(Box::new(Camera { cx, cy, time: time.unwrap_or(f64::NAN), ..camera })))
}
