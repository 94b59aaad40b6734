//! Commands that can be undone, and done again, without limit. What is kept of each is the rows that it changed, bit by bit.

mod before;
mod change;
mod columns;
mod splices;
mod words;

use self::before::Before;
use self::change::Change;
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
    /// That of each command.
    changes: Vec<Change>,
}

impl Entry {
    /// Whether they changed the scene, and not selections alone.
    pub fn changes_scene(&self) -> bool {
        self.changes.iter().any(Change::is_of_scene)
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
        let (mut steps, mut changes) = (Vec::with_capacity(commands.len()), Vec::with_capacity(commands.len()));
        for command in commands {
            let before = Before::of(session, &command.action);
            match session.apply(command) {
                Ok(step) => {
                    steps.push(step);
                    changes.push(Change::since(before, session));
                }
                Err(error) => {
                    before.restore(session);
                    changes.iter_mut().rev().for_each(|change| change.swap(session));
                    return Err(error);
                }
            }
        }
        self.undone.clear();
        self.done.push(Entry { steps, changes });
        Ok(())
    }

    /// Takes back what was done last; `None` at the beginning.
    pub fn undo(&mut self) -> Option<&Entry> {
        let mut entry = self.done.pop()?;
        entry.changes.iter_mut().rev().for_each(|change| change.swap(&mut self.session));
        self.undone.push(entry);
        self.undone.last()
    }

    /// Does again what was undone last; `None` when nothing was.
    pub fn redo(&mut self) -> Option<&Entry> {
        let mut entry = self.undone.pop()?;
        entry.changes.iter_mut().for_each(|change| change.swap(&mut self.session));
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
        self.done.iter().chain(&self.undone).flat_map(|entry| &entry.changes).map(Change::bytes).sum()
    }
}
