//! What may be given up for speed: each knob by name, and presets of them.
//!
//! | knob | values | what it saves | error against the f64 reference |
//! |---|---|---|---|
//! | `cull` | exact, box | `box`: a count without a loop over tile rows, for more tile instances | none |
//! | `alpha_cut` | 1/255 … 1/32 | tile instances and pixels of a splat's rim | a splat loses at most the cut per pixel |
//! | `stop` | 1e-4 … 1e-2 | what lies behind nearly opaque pixels | the splat that would cross the stop and what is behind it: the stop over 1 − its α, at most |
//! | `position` | f32, unorm16 | 6 of 12 bytes of every Gaussian's centre; not with network G, which reads it too | half of 1/65534 of the scene's extent |
//! | `sh_degree` | 0 … 3 | 36, 60 and 84 bytes per visible Gaussian | what the higher bands say |
//! | `sh` | f32, f16, u8 | half or three quarters of the SH bytes | half a step of 2⁻¹¹, of 1/255 of a coefficient's range |
//! | `colour` | f32, f16 | 16 of 48 bytes per splat and tile instance; the opacity is f16 then too | 2⁻¹² of the colour, and of log2 of the opacity |
//! | `table_step` | 1 … 16 | memory of the motion table | ⅛ of the squared step times the motion's curvature |
//! | `interpolation` | linear, geodesic | nothing: screws between the keys cost the host M exponentials per frame | less than linear for wide steps |
//! | `network` | f32, f16 | half of the traffic of network F's weights | poses off by about 1e-3 |
//! | `nonrigid` | on, off | network G | all that G adds |
//! | `resolution` | 0.25 … 1 | pixels; the picture is enlarged bilinearly when it is read | detail |
//!
//! Screen positions and conics stay f32: half precision of a position would be off by half a pixel at 1,000 px, that of a
//! conic adds up over many layers. Half precision of `sh` and `colour` is for colours like an image's: see
//! [`Quality::for_scene`].
//! Training always runs with [`Quality::EXACT`].

mod knobs;

pub use knobs::{KNOBS, Knob};

use crate::error::{Error, Result};
use crate::scene::Scene;

/// SH coefficients up to here have a half-precision error below 1/1000, a quarter of a level of 255.
const HALF_LIMIT: f32 = 4.0;
/// One Gaussian in so many may have larger ones.
const BRIGHT_SHARE: usize = 1000;

/// How the tiles of a splat are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TileCull {
    /// Those that its ellipse touches.
    Exact,
    /// Those that the ellipse's bounding box touches.
    Box,
}

/// How a number is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Storage {
    /// 32-bit float.
    F32,
    /// 16-bit float.
    F16,
    /// 16 bits of each coordinate's own range.
    Unorm16,
    /// 8 bits of each SH coefficient's own range; band 0 then is 16-bit float.
    Bits8,
}

/// How poses between two keys of the motion table are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// So(3) vectors and translations linearly: the model's definition (paper).
    Linear,
    /// Along the screw that leads from one pose to the other.
    Geodesic,
}

/// All knobs; see the module's table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// How the tiles of a splat are found.
    pub cull: TileCull,
    /// Smallest α that is drawn, 1/255 to 1/4.
    pub alpha_cut: f32,
    /// The splat that would take the transmittance below this ends the pixel.
    pub stop: f32,
    /// Storage of the centres: F32 or Unorm16.
    pub position: Storage,
    /// Highest SH degree that is used.
    pub sh_degree: u32,
    /// Storage of SH coefficients.
    pub sh: Storage,
    /// Storage of a projected splat's colour and opacity: F32 or F16.
    pub colour: Storage,
    /// Every so many keys of the motion table are kept, and the last one.
    pub table_step: u32,
    /// Between keys of the motion table.
    pub interpolation: Interpolation,
    /// Storage of network F's hidden matrices: F32 or F16.
    pub network: Storage,
    /// Whether network G is run where the model has it.
    pub nonrigid: bool,
    /// Share of the width and height that is rendered, 1/8 to 1.
    pub resolution: f32,
}

impl Quality {
    /// The definition of the image, in f32.
    pub const EXACT: Self = Self {
        cull: TileCull::Exact,
        alpha_cut: 1.0 / 255.0,
        stop: 1e-4,
        position: Storage::F32,
        sh_degree: 3,
        sh: Storage::F32,
        colour: Storage::F32,
        table_step: 1,
        interpolation: Interpolation::Linear,
        network: Storage::F32,
        nonrigid: true,
        resolution: 1.0,
    };

    /// No visible error: 99.99 % of all values within 1/255 of the definition.
    pub const HIGH: Self = Self { sh: Storage::F16, colour: Storage::F16, ..Self::EXACT };

    /// Names of the presets, and what they are.
    pub const PRESETS: [(&'static str, Self); 2] = [("exact", Self::EXACT), ("high", Self::HIGH)];

    /// These knobs for a scene: its colours decide whether half precision is enough. Where more than one Gaussian in 1,000 has
    /// an SH coefficient beyond ±4 (colours far outside an image's), `sh` and `colour` are f32. Network G and deformation
    /// fields read the centres too, as f32.
    pub fn for_scene(mut self, scene: &Scene) -> Self {
        let gaussians = &scene.gaussians;
        if scene.deformation.nonrigid().is_some() && self.nonrigid || scene.deformation.field().is_some() {
            self.position = Storage::F32;
        }
        let rows = gaussians.sh.chunks_exact(3 * gaussians.sh_coefficients());
        let bright = rows.filter(|row| row.iter().any(|c| c.is_finite() && c.abs() > HALF_LIMIT)).count();
        if bright * BRIGHT_SHARE > gaussians.len() {
            (self.sh, self.colour) = (Storage::F32, Storage::F32);
        }
        self
    }

    /// A preset by name.
    ///
    /// # Errors
    /// `Usage` for an unknown name, and for `fast`, a preset of earlier versions.
    pub fn named(name: &str) -> Result<Self> {
        let expected = match name {
            "fast" => "exact or high; fast saved too little and is gone: turn its knobs with --set sh=u8,stop=0.001",
            _ => "exact or high",
        };
        let preset = Self::PRESETS.into_iter().find(|(n, _)| *n == name);
        preset.map(|(_, q)| q).ok_or_else(|| Error::usage("quality", name, expected))
    }

    /// Turns one knob.
    ///
    /// # Errors
    /// `Usage` for an unknown knob or a value that it does not take.
    pub fn set(&mut self, knob: &str, value: &str) -> Result<()> {
        let Some(found) = KNOBS.iter().find(|k| k.name == knob) else {
            let names: Vec<&str> = KNOBS.iter().map(|k| k.name).collect();
            return Err(Error::usage("knob of quality", knob, format!("one of {}", names.join(", "))));
        };
        found.set(self, value).ok_or_else(|| Error::usage(format!("knob {knob}"), value, found.takes))
    }

    /// Turns the knobs of a list `knob=value,knob=value`.
    ///
    /// # Errors
    /// As [`Quality::set`].
    pub fn set_all(&mut self, list: &str) -> Result<()> {
        for part in list.split(',').map(str::trim).filter(|p| !p.is_empty()) {
            let Some((knob, value)) = part.split_once('=') else {
                return Err(Error::usage("knobs of quality", part, "knob=value"));
            };
            self.set(knob.trim(), value.trim())?;
        }
        Ok(())
    }

    /// What differs from a preset, or from `exact` when it is none: `high`, `exact, stop=0.001`.
    pub fn describe(&self) -> String {
        if let Some((name, _)) = Self::PRESETS.iter().find(|(_, q)| q == self) {
            return (*name).to_owned();
        }
        let different = KNOBS.iter().filter(|k| k.get(self) != k.get(&Self::EXACT));
        let parts: Vec<String> = different.map(|k| format!("{}={}", k.name, k.get(self))).collect();
        format!("exact, {}", parts.join(", "))
    }

    /// Every knob with its value.
    pub fn knobs(&self) -> Vec<(&'static str, String)> {
        KNOBS.iter().map(|k| (k.name, k.get(self))).collect()
    }

    /// Whether frames need other variants of the kernels than exact ones.
    pub(crate) fn changes_kernels(&self) -> bool {
        let Self { sh_degree, table_step, interpolation, nonrigid, resolution, .. } = Self::EXACT;
        Self { sh_degree, table_step, interpolation, nonrigid, resolution, ..*self } != Self::EXACT
    }

    /// Specialisation constant `ALPHA_CUT`: bits of log2(1/cut); 0 stands for 1/255.
    pub fn alpha_cut_constant(&self) -> u32 {
        if self.alpha_cut == Self::EXACT.alpha_cut { 0 } else { (-self.alpha_cut.log2()).to_bits() }
    }

    /// Specialisation constant `TRANSMITTANCE_STOP`: bits of it; 0 stands for 1e-4.
    pub fn stop_constant(&self) -> u32 {
        if self.stop == Self::EXACT.stop { 0 } else { self.stop.to_bits() }
    }

    /// Specialisation constant `TILE_CULL`.
    pub fn cull_constant(&self) -> u32 {
        u32::from(self.cull == TileCull::Box)
    }

    /// Specialisation constant `PACKING`.
    pub fn packing_constant(&self) -> u32 {
        self.colour.constant()
    }
}

impl Default for Quality {
    fn default() -> Self {
        Self::EXACT
    }
}

impl Storage {
    /// Value of a specialisation constant.
    pub const fn constant(self) -> u32 {
        match self {
            Self::F32 => 0,
            Self::F16 | Self::Unorm16 => 1,
            Self::Bits8 => 2,
        }
    }
}

impl serde::Serialize for Quality {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_map(self.knobs())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn every_value_of_the_sweep_is_taken_and_given_back() {
        for knob in KNOBS {
            assert_eq!(knob.get(&Quality::EXACT), knob.values[0], "the first value of {} is the exact one", knob.name);
            for value in knob.values {
                let mut q = Quality::EXACT;
                q.set(knob.name, value).unwrap();
                assert_eq!(knob.get(&q), *value, "{}", knob.name);
                assert_eq!(q == Quality::EXACT, *value == knob.values[0], "{} = {value}", knob.name);
            }
        }
    }

    #[test]
    fn bright_scenes_keep_full_precision() {
        let mut scene = Scene::default();
        (scene.gaussians.mean, scene.gaussians.sh) = (vec![[0.0; 3]; 2000], vec![0.5; 3 * 2000]);
        scene.gaussians.sh[7] = 9.0;
        scene.gaussians.sh[3001] = -9.0;
        scene.gaussians.sh[5000] = f32::NAN;
        assert_eq!(Quality::HIGH.for_scene(&scene), Quality::HIGH);
        scene.gaussians.sh[4000] = 4.1;
        let kept = Quality::HIGH.for_scene(&scene);
        assert_eq!(kept, Quality { sh: Storage::F32, colour: Storage::F32, ..Quality::HIGH });
        assert_eq!(Quality::HIGH.for_scene(&Scene::default()), Quality::HIGH);
    }

    #[test]
    fn mistakes_name_the_knob_and_what_it_takes() {
        let mut q = Quality::EXACT;
        for (list, part) in [
            ("alpha=1", "one of interpolation"),
            ("table_step=65", "1 to 64"),
            ("table_step=x", "1 to 64"),
            ("depth_bits=16", "one of"),
            ("stop=nan", "1e-6"),
            ("alpha_cut=1/256", "1/255"),
            ("colour=u8", "f32 or f16"),
            ("conic=f16", "one of"),
            ("sh", "knob=value"),
            ("resolution=2", "1"),
        ] {
            let error = q.set_all(list).unwrap_err().to_string();
            assert!(error.contains(part), "{list}: {error}");
        }
        assert_eq!(q, Quality::EXACT);
        assert!(Quality::named("best").is_err());
        // What replaces a preset that is gone must be accepted.
        let gone = Quality::named("fast").unwrap_err().to_string();
        let (_, list) = gone.split_once("--set ").unwrap();
        q.set_all(list.split_whitespace().next().unwrap()).unwrap();
        assert_eq!((q.stop, q.sh), (0.001, Storage::Bits8));
    }

    #[test]
    fn lists_and_descriptions_agree() {
        let mut q = Quality::named("exact").unwrap();
        assert_eq!(q.describe(), "exact");
        q.set_all("alpha_cut = 1/64, stop=0.001").unwrap();
        assert_eq!(q.describe(), "exact, alpha_cut=1/64, stop=0.001");
        assert_eq!(q.alpha_cut_constant(), 6.0_f32.to_bits());
        assert_eq!(Quality::HIGH.describe(), "high");
        assert_eq!(Quality::EXACT.alpha_cut_constant() + Quality::EXACT.stop_constant(), 0);
    }
}
