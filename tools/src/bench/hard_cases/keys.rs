//! Case 6: sorting by fewer bits of the depth, and case 5: what the order of storage may change.

use engine::error::Result;
use engine::image::difference;
use engine::reference::gradient::image::visible_splats;
use engine::reference::{DeformationAt, Gaussians64, Splat};
use engine::render::Renderer;
use engine::scene::Scene;
use engine::scene::synthetic::random_scene;

use super::blend::{Rules, blend};
use super::case::{Case, Check, Context, Outcome};
use super::compare::{options_of, reference_options, usual_options};
use super::{images, views};

/// Key widths that published renderers use, and ours, 32.
const KEY_BITS: [u32; 4] = [18, 20, 24, 32];

pub(super) fn cases() -> Vec<Case> {
    let mut all: Vec<Case> = KEY_BITS
        .into_iter()
        .map(|bits| {
            let input =
                format!("800 depths from 1e-3 to 1e5, sorted by the upper {bits} bits of the f32 depth (f64 study).");
            Case::new(6, format!("depth_keys_{bits}"), input, move |_| judge_keys(bits))
        })
        .collect();
    let input = "2,000 Gaussians stored in another order, and 20,000 hidden ones added.";
    all.push(Case::new(5, "storage_order", input, judge_storage_order));
    all
}

/// The upper `bits` bits of the depth as f32. Depths are positive, so the sign bit is always 0.
fn key(depth: f64, bits: u32) -> u32 {
    (depth as f32).to_bits() >> (32 - bits)
}

/// Pairs in the wrong order, and the largest relative difference of depth within one.
fn inversions(order: &[&Splat]) -> (usize, f64) {
    let (mut count, mut gap) = (0, 0.0_f64);
    for (i, far) in order.iter().enumerate() {
        for near in &order[i + 1..] {
            if near.depth < far.depth {
                count += 1;
                gap = gap.max((far.depth - near.depth) / near.depth);
            }
        }
    }
    (count, gap)
}

fn judge_keys(bits: u32) -> Result<Outcome> {
    let case = images::named("depth_range")?;
    let options = reference_options(&options_of(&case));
    let splats =
        visible_splats(&Gaussians64::from(&case.scene.gaussians), &DeformationAt::default(), &case.camera, &options)?;
    let mut order: Vec<&Splat> = splats.iter().collect();
    order.sort_by_key(|s| (key(s.depth, bits), s.index));
    let (count, gap) = inversions(&order);
    let exact = blend(splats.iter(), &case.camera, options.background, Rules::default());
    let test = blend(order.iter().copied(), &case.camera, options.background, Rules::default());
    let error = difference(exact, test);
    // Of the f32, 9 bits are sign and exponent; the rest resolves the mantissa to 2^(9 − bits).
    let resolution = 2.0_f64.powi(9 - bits as i32);
    let pairs = splats.len() * (splats.len() - 1) / 2;
    let mut checks = vec![
        Check::shown("largest colour error of the order alone", error.max),
        Check::shown("PSNR of that order, dB", error.psnr),
        Check::shown("pairs in the wrong order", count as f64),
        Check::at_most("largest relative depth difference among them", gap, resolution),
    ];
    if bits == 32 {
        checks[0] = Check::at_most("largest colour error of the order alone", error.max, 0.0);
        checks[2] = Check::exactly("pairs in the wrong order", count, 0);
    }
    Ok(Outcome {
        truth: format!("{} splats, {pairs} pairs; depths resolved to {resolution:.1e}", splats.len()),
        checks,
    })
}

/// The same Gaussians in another order, with others that nobody sees: nothing may change but the bits of ties, and here
/// there are none.
fn judge_storage_order(context: &Context<'_>) -> Result<Outcome> {
    let scene = random_scene(2000, 11, 1);
    let g = &scene.gaussians;
    // 7 and 2000 have no common factor: a permutation.
    let order: Vec<usize> = (0..g.len()).map(|i| (7 * i + 3) % g.len()).collect();
    let mut shuffled = Scene { gaussians: g.selected(&order), ..Scene::default() };
    let row = 3 * g.sh_coefficients();
    for i in 0..20_000 {
        let h = &mut shuffled.gaussians;
        h.mean.push([0.0, 0.0, -10.0 - i as f32 * 0.01]);
        h.log_scale.push([-3.0; 3]);
        h.rotation.push([1.0, 0.0, 0.0, 0.0]);
        h.opacity_logit.push(2.0);
        h.sh.extend(std::iter::repeat_n(0.5, row));
    }
    let camera = views::camera(128, 96);
    let render = |scene: &Scene| Renderer::new(context.gpu, scene, &usual_options())?.render(&camera, 0.0);
    let (plain, other) = (render(&scene)?, render(&shuffled)?);
    let changed = plain.rgba.iter().zip(&other.rgba).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
    Ok(Outcome {
        truth: "no two depths are equal: the image depends on neither order nor hidden Gaussians".into(),
        checks: vec![Check::exactly("values whose bits changed", changed, 0)],
    })
}
