//! What is kept of a session while a command changes it.

use super::splices::Splices;
use crate::edit::masks::Masks;
use crate::edit::script::{Action, Change};
use crate::edit::session::{Seen, Session};
use crate::scene::{Gaussians, Scene};

/// A session as it was before a command; the scene only if that may change it.
#[derive(Debug)]
pub(super) struct Before {
    /// Without SH coefficients where `colors` has what changes of them.
    pub(super) scene: Option<Scene>,
    /// What will make the old SH coefficients of the new ones: they are most of a scene, and a copy of all takes long.
    pub(super) colors: Option<Splices>,
    /// The action leaves Gaussians as they are: `scene` is without their [`Kept`] arrays.
    pub(super) keeps_gaussians: bool,
    pub(super) masks: Masks,
    pub(super) seen: Seen,
}

/// The arrays that all Gaussians have, taken out of a scene: most of it.
pub(super) struct Kept {
    vectors: [Vec<[f32; 3]>; 2],
    rotation: Vec<[f32; 4]>,
    numbers: [Vec<f32>; 2],
}

impl Kept {
    pub(super) fn take(g: &mut Gaussians) -> Self {
        Self {
            vectors: [&mut g.mean, &mut g.log_scale].map(std::mem::take),
            rotation: std::mem::take(&mut g.rotation),
            numbers: [&mut g.opacity_logit, &mut g.sh].map(std::mem::take),
        }
    }

    pub(super) fn put(self, g: &mut Gaussians) {
        ([g.mean, g.log_scale], g.rotation, [g.opacity_logit, g.sh]) = (self.vectors, self.rotation, self.numbers);
    }
}

impl Before {
    /// The session before `action`.
    pub(super) fn of(session: &mut Session, action: &Action) -> Self {
        let (mut scene, mut colors) = (None, None);
        let keeps_gaussians = matches!(action, Action::Change { during: Some(_), .. });
        if keeps_gaussians {
            let kept = Kept::take(&mut session.scene.gaussians);
            scene = Some(session.scene.clone());
            kept.put(&mut session.scene.gaussians);
        } else if action.changes_scene() {
            colors = changed_colors(session, action);
            let sh = colors.is_some().then(|| std::mem::take(&mut session.scene.gaussians.sh));
            scene = Some(session.scene.clone());
            if let Some(sh) = sh {
                session.scene.gaussians.sh = sh;
            }
        }
        Self { scene, colors, keeps_gaussians, masks: session.masks.clone(), seen: session.seen.clone() }
    }

    /// Makes a session what it was before an action that failed: rows were then neither added nor taken away.
    pub(super) fn restore(self, session: &mut Session) {
        (session.masks, session.seen) = (self.masks, self.seen);
        let Some(mut scene) = self.scene else { return };
        if self.keeps_gaussians {
            Kept::take(&mut session.scene.gaussians).put(&mut scene.gaussians);
        }
        if let Some(mut colors) = self.colors {
            scene.gaussians.sh = std::mem::take(&mut session.scene.gaussians.sh);
            colors.restore(&mut scene.gaussians.sh);
        }
        session.scene = scene;
    }
}

/// What an action does to SH coefficients; `None` where only a comparison tells.
fn changed_colors(session: &Session, action: &Action) -> Option<Splices> {
    let g = &session.scene.gaussians;
    let (sh, width) = (bytemuck::cast_slice(&g.sh), 3 * g.sh_coefficients());
    let selected = session.selected().unwrap_or_default();
    match action {
        Action::Change { change: Change::Rotate(..), .. } | Action::Recolor(_) => {
            Some(Splices::overwritten(sh, width, selected))
        }
        Action::Change { .. } | Action::Retime(_) => Some(Splices::added(0, width, 0)),
        Action::Delete => Some(Splices::removed(sh, width, selected)),
        Action::Keep => {
            let gone: Vec<bool> = session.kept().unwrap_or_default().into_iter().map(|kept| !kept).collect();
            Some(Splices::removed(sh, width, &gone))
        }
        Action::Duplicate => Some(Splices::added(g.len(), width, selected.iter().filter(|m| **m).count())),
        _ => None,
    }
}
