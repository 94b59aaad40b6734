//! Commands that can be undone, and done again, without limit. What is kept of each is the rows that it changed, bit by bit.

mod change;
mod columns;
mod splices;

use self::change::{Before, Change};
use super::script::Command;
use super::session::{Session, Step};
use crate::error::Result;

/// A session with its past, and with what was undone.
#[derive(Debug)]
pub struct History {
    session: Session,
    done: Vec<Entry>,
    /// The one undone last at the end.
    undone: Vec<Entry>,
}

/// Commands that are done and undone together.
#[derive(Debug)]
pub struct Entry {
    /// What they came to.
    pub steps: Vec<Step>,
    change: Change,
}

impl Entry {
    /// Whether they changed the scene, and not selections alone.
    pub fn changes_scene(&self) -> bool {
        self.change.is_of_scene()
    }
}

impl History {
    /// A session that begins.
    pub fn new(session: Session) -> Self {
        Self { session, done: Vec::new(), undone: Vec::new() }
    }

    /// The session as it is now.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Carries out commands, all or none; what was undone can then not be done again.
    ///
    /// # Errors
    /// Those of the commands. The session is then as it was before.
    pub fn run(&mut self, commands: &[Command]) -> Result<()> {
        let session = &mut self.session;
        let changes = commands.iter().any(|command| command.action.changes_scene());
        let scene = changes.then(|| session.scene.clone());
        let before = Before { scene, masks: session.masks.clone(), seen: session.seen.clone() };
        let steps: Result<Vec<Step>> = commands.iter().map(|command| session.apply(command)).collect();
        match steps {
            Ok(steps) => {
                self.undone.clear();
                let change = Change::since(before, session);
                self.done.push(Entry { steps, change });
                Ok(())
            }
            Err(error) => {
                (session.masks, session.seen) = (before.masks, before.seen);
                if let Some(scene) = before.scene {
                    session.scene = scene;
                }
                Err(error)
            }
        }
    }

    /// Takes back what was done last; `None` at the beginning.
    pub fn undo(&mut self) -> Option<&Entry> {
        let mut entry = self.done.pop()?;
        entry.change.swap(&mut self.session);
        self.undone.push(entry);
        self.undone.last()
    }

    /// Does again what was undone last; `None` when nothing was.
    pub fn redo(&mut self) -> Option<&Entry> {
        let mut entry = self.undone.pop()?;
        entry.change.swap(&mut self.session);
        self.done.push(entry);
        self.done.last()
    }

    /// What was done, in order.
    pub fn done(&self) -> &[Entry] {
        &self.done
    }

    /// What was undone, the last one at the end.
    pub fn undone(&self) -> &[Entry] {
        &self.undone
    }

    /// What was done, command by command: the list that makes the same scene again.
    pub fn steps(&self) -> impl Iterator<Item = &Step> {
        self.done.iter().flat_map(|entry| &entry.steps)
    }

    /// Bytes that the past takes: of rows and selections that are no longer, or are no longer undone.
    pub fn bytes(&self) -> usize {
        self.done.iter().chain(&self.undone).map(|entry| entry.change.bytes()).sum()
    }
}
