//! The knobs by name.

use super::{Interpolation, Quality, Storage, TileCull};

/// One setting of [`Quality`].
#[derive(Debug)]
pub struct Knob {
    /// Its name on the command line and in reports.
    pub name: &'static str,
    /// What it does, in a line.
    pub doc: &'static str,
    /// What it takes, for error messages.
    pub takes: &'static str,
    /// Values of a sweep, the exact one first.
    pub values: &'static [&'static str],
    get: fn(&Quality) -> String,
    set: fn(&mut Quality, &str) -> Option<()>,
}

impl Knob {
    /// The value as text.
    pub fn get(&self, quality: &Quality) -> String {
        (self.get)(quality)
    }

    /// Sets it; `None` for a value that it does not take.
    pub fn set(&self, quality: &mut Quality, value: &str) -> Option<()> {
        (self.set)(quality, value)
    }
}

/// Every knob, in the order of the pipeline.
pub static KNOBS: &[Knob] = &[
    Knob {
        name: "interpolation",
        doc: "poses between the keys of the motion table",
        takes: "linear or geodesic",
        values: &["linear", "geodesic"],
        get: |q| if q.interpolation == Interpolation::Linear { "linear".into() } else { "geodesic".into() },
        set: |q, v| {
            q.interpolation = pick(v, &[("linear", Interpolation::Linear), ("geodesic", Interpolation::Geodesic)])?;
            Some(())
        },
    },
    Knob {
        name: "table_step",
        doc: "every so many keys of the motion table are kept",
        takes: "a whole number, 1 to 64",
        values: &["1", "2", "4", "8", "16"],
        get: |q| q.table_step.to_string(),
        set: |q, v| {
            q.table_step = whole(v, 1, 64)?;
            Some(())
        },
    },
    Knob {
        name: "network",
        doc: "storage of network F's hidden matrices",
        takes: "f32 or f16",
        values: &["f32", "f16"],
        get: |q| storage_name(q.network, "u8"),
        set: |q, v| {
            q.network = pick(v, &[("f32", Storage::F32), ("f16", Storage::F16)])?;
            Some(())
        },
    },
    Knob {
        name: "nonrigid",
        doc: "whether network G is run",
        takes: "on or off",
        values: &["on", "off"],
        get: |q| if q.nonrigid { "on".into() } else { "off".into() },
        set: |q, v| {
            q.nonrigid = pick(v, &[("on", true), ("off", false)])?;
            Some(())
        },
    },
    Knob {
        name: "position",
        doc: "storage of the Gaussians' centres",
        takes: "f32 or unorm16",
        values: &["f32", "unorm16"],
        get: |q| storage_name(q.position, "u8"),
        set: |q, v| {
            q.position = pick(v, &[("f32", Storage::F32), ("unorm16", Storage::Unorm16)])?;
            Some(())
        },
    },
    Knob {
        name: "sh_degree",
        doc: "highest SH degree that is used",
        takes: "0 to 3",
        values: &["3", "2", "1", "0"],
        get: |q| q.sh_degree.to_string(),
        set: |q, v| {
            q.sh_degree = whole(v, 0, 3)?;
            Some(())
        },
    },
    Knob {
        name: "sh",
        doc: "storage of SH coefficients",
        takes: "f32, f16 or u8",
        values: &["f32", "f16", "u8"],
        get: |q| storage_name(q.sh, "u8"),
        set: |q, v| {
            q.sh = pick(v, &[("f32", Storage::F32), ("f16", Storage::F16), ("u8", Storage::Bits8)])?;
            Some(())
        },
    },
    Knob {
        name: "colour",
        doc: "storage of a projected splat's colour and opacity",
        takes: "f32 or f16",
        values: &["f32", "f16"],
        get: |q| storage_name(q.colour, "u8"),
        set: |q, v| {
            q.colour = pick(v, &[("f32", Storage::F32), ("f16", Storage::F16)])?;
            Some(())
        },
    },
    Knob {
        name: "cull",
        doc: "tiles of a splat: those of its ellipse or of the ellipse's box",
        takes: "exact or box",
        values: &["exact", "box"],
        get: |q| if q.cull == TileCull::Exact { "exact".into() } else { "box".into() },
        set: |q, v| {
            q.cull = pick(v, &[("exact", TileCull::Exact), ("box", TileCull::Box)])?;
            Some(())
        },
    },
    Knob {
        name: "alpha_cut",
        doc: "smallest alpha that is drawn",
        takes: "1/255 to 1/4 (or as a decimal number)",
        values: &["1/255", "1/192", "1/128", "1/64", "1/32"],
        get: |q| format!("1/{}", short(1.0 / q.alpha_cut)),
        set: |q, v| {
            let value = match v.strip_prefix("1/") {
                Some(parts) => 1.0 / parts.parse::<f32>().ok()?,
                None => v.parse().ok()?,
            };
            q.alpha_cut = Some(value).filter(|v| (Quality::EXACT.alpha_cut..=0.25).contains(v))?;
            Some(())
        },
    },
    Knob {
        name: "stop",
        doc: "transmittance at which a pixel is done",
        takes: "1e-6 to 0.5",
        values: &["0.0001", "0.001", "0.003", "0.01"],
        get: |q| q.stop.to_string(),
        set: |q, v| {
            q.stop = v.parse().ok().filter(|v| (1e-6..=0.5).contains(v))?;
            Some(())
        },
    },
    Knob {
        name: "resolution",
        doc: "share of the width and height that is rendered",
        takes: "0.125 to 1",
        values: &["1", "0.75", "0.5", "0.25"],
        get: |q| q.resolution.to_string(),
        set: |q, v| {
            q.resolution = v.parse().ok().filter(|v| (0.125..=1.0).contains(v))?;
            Some(())
        },
    },
];

fn pick<T: Copy>(value: &str, choices: &[(&str, T)]) -> Option<T> {
    choices.iter().find(|(name, _)| *name == value).map(|(_, v)| *v)
}

fn whole(value: &str, low: u32, high: u32) -> Option<u32> {
    value.parse().ok().filter(|v| (low..=high).contains(v))
}

fn storage_name(storage: Storage, bits8: &str) -> String {
    match storage {
        Storage::F32 => "f32",
        Storage::F16 => "f16",
        Storage::Unorm16 => "unorm16",
        Storage::Bits8 => bits8,
    }
    .to_owned()
}

/// `255`, `64.5`.
fn short(value: f32) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
