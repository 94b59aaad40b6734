//! The f64 reference on a case.

use std::collections::BTreeMap;

use engine::reference::gradient::association::{Placement, PlacementGradient};
use engine::reference::gradient::network::{LinearGradient, network_gradient};
use engine::reference::gradient::property::PropertyInput;
use engine::reference::{Pose, network_poses};
use glam::DVec3;

use super::case::Case;
use super::results::{FORMS, Gradients, Results, flat_mean, loss_names};

fn promote(v: &[f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

/// Means, quaternions and poses of the case in f64.
struct Exact {
    mean: Vec<DVec3>,
    rotation: Vec<[f64; 4]>,
    position: Vec<DVec3>,
    pose: Vec<Pose>,
}

impl Exact {
    fn new(case: &Case) -> Self {
        let g = &case.scene.gaussians;
        Self {
            mean: g.mean.iter().map(promote).collect(),
            rotation: g.rotation.iter().map(|q| q.map(f64::from)).collect(),
            position: case.position.iter().map(promote).collect(),
            pose: network_poses(&case.network, &case.position, case.time),
        }
    }

    fn placement<'a>(&'a self, case: &'a Case) -> Placement<'a> {
        Placement { mean: &self.mean, rotation: &self.rotation, of_gaussian: &case.of_gaussian, pose: &self.pose }
    }
}

/// Gradient of motion per Gaussian and superpoint.
pub(super) fn motion(case: &Case) -> PlacementGradient {
    Exact::new(case).placement(case).gradient(&case.d_mean, &case.d_rotation)
}

fn network(case: &Case, d_pose: &[Pose]) -> BTreeMap<String, Vec<f64>> {
    let (d_rotation, d_translation): (Vec<DVec3>, Vec<DVec3>) =
        d_pose.iter().map(|p| (p.rotation, p.translation)).unzip();
    let g = network_gradient(&case.network, &case.position, case.time, &d_rotation, &d_translation);
    let linear = g.linear.into_iter().enumerate().map(|(i, l)| (format!("linear.{i}"), l));
    let heads = [("translation".to_owned(), g.translation), ("rotation".to_owned(), g.rotation)];
    linear
        .chain(heads)
        .flat_map(|(name, LinearGradient { weight, bias })| {
            [(format!("deform_{name}.weight"), weight), (format!("deform_{name}.bias"), bias)]
        })
        .collect()
}

pub(super) fn results(case: &Case) -> Results {
    let exact = Exact::new(case);
    let placed = exact.placement(case).place();
    let vectors = |of: &dyn Fn(&Pose) -> DVec3| exact.pose.iter().flat_map(|p| of(p).to_array()).collect::<Vec<f64>>();
    let mut out = Results::default();
    out.outputs.insert("out_rotation", vectors(&|p| p.rotation));
    out.outputs.insert("out_translation", vectors(&|p| p.translation));
    out.outputs.insert("out_mean_t", placed.iter().flat_map(|(x, _)| x.to_array()).collect());
    out.outputs.insert("out_rotation_t", placed.iter().flat_map(|(_, r)| r.transpose().to_cols_array()).collect());
    let motion = motion(case);
    let moved = Gradients {
        mean: Some(motion.mean.iter().flat_map(|v| v.to_array()).collect()),
        rotation: Some(motion.rotation.concat()),
        logit: Some(vec![0.0; case.logit.len()]),
        network: network(case, &motion.pose),
    };
    out.gradients.insert("motion", moved);
    let logit: Vec<f64> = case.logit.iter().map(|x| f64::from(*x)).collect();
    for (name, form, lambda) in FORMS {
        let input = PropertyInput {
            mean: &exact.mean,
            of_gaussian: &case.of_gaussian,
            neighbors: case.neighbors,
            neighbor: &case.neighbor,
            logit: &logit,
            position: &exact.position,
            pose: &exact.pose,
        };
        // The file's weights are decimal numbers, not the f32 beside them.
        let decimal = lambda.map(|l| if l < 0.1 { 1e-3 } else { f64::from(l) });
        let g = input.gradient(form, decimal);
        out.losses.extend(loss_names(name).into_iter().zip(g.loss));
        let gradients = Gradients {
            mean: Some(flat_mean(&g)),
            // No property depends on a Gaussian's own rotation.
            rotation: Some(vec![0.0; 4 * exact.rotation.len()]),
            network: network(case, &g.pose),
            logit: Some(g.logit),
        };
        out.gradients.insert(name, gradients);
    }
    out
}
