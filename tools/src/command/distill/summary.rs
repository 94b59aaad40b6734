//! What was done, for people and as JSON.

use std::path::PathBuf;

use engine::distill::Report;
use serde::Serialize;

use super::compare::Comparison;
use super::photos::Photos;
use super::tune::Tuning;

/// What was done.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// What was read.
    pub teacher: PathBuf,
    /// The folder that was written.
    pub out: PathBuf,
    /// The motion, and how far off it is.
    pub motion: Report,
    /// What fine-tuning did, where it was asked for; the model, images and photos are those after it.
    pub tuning: Option<Tuning>,
    /// Bytes of the teacher, where it is one file, and of the student.
    pub bytes: [Option<u64>; 2],
    /// Where pixels are measured.
    pub measured_in: String,
    /// Images of both.
    pub images: Option<Comparison>,
    /// Both beside photos.
    pub photos: Option<Photos>,
}

impl Summary {
    /// For people.
    pub(super) fn lines(&self) -> Vec<String> {
        let m = &self.motion;
        let [before, after] = m.superpoints;
        let mut lines = vec![
            format!(
                "motion  {after} superpoints ({before} before, {} of one Gaussian), {} key times; {} of {} Gaussians rest",
                m.singletons, m.key_times, m.still, m.gaussians[1]
            ),
            format!("error   {}", verdict(m)),
            format!(
                "        at key times {:.4} px, between them {:.4} px; 99.9 % of the Gaussians within {:.4} px, turned by less than {:.2}°",
                m.at_keys_px, m.between_px, m.error_px.q999, m.rotation_degrees.q999
            ),
            format!("        measured in {}, at {} times", self.measured_in, m.sampled_times + m.checked_times),
        ];
        if m.soft > 0 {
            lines.push(format!("blend   {} Gaussians move with several superpoints", m.soft));
        }
        if !m.dropped.is_empty() {
            lines.push(format!("left out: {}", m.dropped.join("; ")));
        }
        lines.extend(self.tuning.iter().flat_map(Tuning::lines));
        lines.extend(self.images.iter().map(|images| format!("images  {}", images.line())));
        lines.extend(self.photos.iter().map(|photos| format!("photos  {}", photos.line())));
        let bytes = |b: Option<u64>| b.map_or("?".into(), |b| b.to_string());
        lines.push(format!("bytes   {} of the teacher, {} of the student", bytes(self.bytes[0]), bytes(self.bytes[1])));
        let [teacher, fit, keys] = m.seconds;
        lines.push(format!(
            "time    {teacher:.1} s for the teacher's motion, {fit:.1} s to fit it, {keys:.1} s for key times"
        ));
        lines.push(format!("written {}", self.out.display()));
        lines
    }
}

/// Whether the error is within the bound, and if not, why.
pub(super) fn verdict(m: &Report) -> String {
    let (largest, bound) = (m.error_px.largest, m.bound_px);
    if m.is_within() {
        return format!("largest {largest:.4} px, within the bound of {bound} px");
    }
    let why = if m.capped {
        format!("--max-superpoints allows {}", m.superpoints[1])
    } else {
        format!("the motion is too quick for {} times", m.sampled_times)
    };
    format!("largest {largest:.4} px, above the bound of {bound} px: {} Gaussians are above it; {why}", m.above)
}
