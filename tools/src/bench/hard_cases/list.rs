//! All cases.

use super::case::Case;
use super::{capacity, checkpoint, drift, gradients, images, keys, layers, motion, poison, repeat, steady, views};

/// All cases, by number.
pub fn cases() -> Vec<Case> {
    let mut all = images::cases();
    all.extend(keys::cases());
    all.extend(layers::cases());
    all.extend(views::cases());
    all.extend(motion::cases());
    all.extend(capacity::cases());
    all.extend(gradients::cases());
    all.extend(repeat::cases());
    all.extend(drift::cases());
    all.extend(steady::cases());
    all.extend(checkpoint::cases());
    all.extend(poison::cases());
    all.sort_by_key(|case| case.number);
    all
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::bench::hard_cases::case::GROUPS;

    #[test]
    fn every_group_has_a_case_and_names_are_unique() {
        let all = cases();
        for number in 1..=GROUPS.len() {
            assert!(all.iter().any(|c| c.number == number), "no case {number}: {}", GROUPS[number - 1]);
        }
        let mut names: Vec<&str> = all.iter().map(|c| c.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all.len());
        assert!(all.iter().all(|c| c.input.ends_with('.')), "inputs are sentences");
    }
}
