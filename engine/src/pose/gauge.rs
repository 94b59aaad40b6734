//! What photos of one moment cannot tell: whether all superpoints have moved as one, or the cameras the other way.

use glam::{DMat3, DQuat, DVec3};

use super::bodies::{Bodies, Stand};
use super::solver::State;

/// Gives to the cameras what all superpoints have moved by as one since `expected` (or since the search began): the images stay the
/// same.
pub(super) fn fix(bodies: &Bodies, state: &mut State, expected: Option<&[Stand]>) {
    let first;
    let reference = match expected {
        Some(expected) => expected,
        None => {
            first = bodies.stands(&state.start);
            &first
        }
    };
    let Some((turn, shift)) = common(reference, &state.stands) else { return };
    let back = turn.conjugate();
    for stand in &mut state.stands {
        *stand = Stand { turn: (back * stand.turn).normalize(), place: back * (stand.place - shift) };
    }
    state.sights.iter_mut().for_each(|sight| sight.follow(back, shift));
}

/// The rigid change x ↦ Rx + s that takes the places `from` nearest to `to` in the sense of least squares, by Gauss–Newton from the
/// mean turn; `None` for fewer than three.
fn common(from: &[Stand], to: &[Stand]) -> Option<(DQuat, DVec3)> {
    if from.len() < 3 {
        return None;
    }
    let n = from.len() as f64;
    let mean = |stands: &[Stand]| stands.iter().map(|s| s.place).sum::<DVec3>() / n;
    let (a, b) = (mean(from), mean(to));
    // Turns vote too, which decides where places lie on a line.
    let mut turn = from.iter().zip(to).map(|(f, t)| t.turn * f.turn.conjugate()).fold(
        DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0),
        |sum, q| {
            if q.w < 0.0 { sum - q } else { sum + q }
        },
    );
    turn = if turn.length() > 1e-9 { turn.normalize() } else { DQuat::IDENTITY };
    let spread: f64 = from.iter().map(|s| s.place.distance_squared(a)).sum();
    for _ in 0..20 {
        // Gauss–Newton on Σ ‖R(f − a) − (t − b)‖².
        let (mut matrix, mut right) = (DMat3::from_diagonal(DVec3::splat(1e-9 * spread.max(1e-300))), DVec3::ZERO);
        for (f, t) in from.iter().zip(to) {
            let (x, y) = (turn * (f.place - a), t.place - b);
            matrix += DMat3::from_diagonal(DVec3::splat(x.length_squared())) - outer(x);
            right += x.cross(y);
        }
        let step = matrix.inverse() * right;
        if !step.is_finite() {
            break;
        }
        turn = (DQuat::from_scaled_axis(step) * turn).normalize();
        if step.length() < 1e-12 {
            break;
        }
    }
    Some((turn, b - turn * a))
}

fn outer(x: DVec3) -> DMat3 {
    DMat3::from_cols(x * x.x, x * x.y, x * x.z)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::scene::synthetic::Random;

    #[test]
    fn a_common_motion_is_found() {
        let mut random = Random::new(8);
        let from: Vec<Stand> = (0..12).map(|_| Stand { turn: random.rotation(), place: random.normal3() }).collect();
        let (turn, shift) = (DQuat::from_scaled_axis(DVec3::new(0.9, -0.4, 1.1)), DVec3::new(0.3, 2.0, -1.0));
        let to: Vec<Stand> =
            from.iter().map(|s| Stand { turn: turn * s.turn, place: turn * s.place + shift }).collect();
        let (found, moved) = common(&from, &to).unwrap();
        assert!(found.angle_between(turn) < 1e-6 && moved.distance(shift) < 1e-9, "{found} {moved}");
        assert!(common(&from[..2], &to[..2]).is_none());
    }
}
