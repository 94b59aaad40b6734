#![allow(clippy::unwrap_used, reason = "tests")]

use super::*;

const UNTIL: u64 = 1000;
/// None is kept aside.
const ALL: KeptAside = KeptAside::new(0, 0);

fn window() -> TimeWindow {
    let times: Vec<f64> = (0..40).map(|i| f64::from(i) / 39.0).collect();
    TimeWindow::new(&times, ALL, 0.5, [100, UNTIL]).unwrap()
}

/// Draws and widens until it is open, with these losses by photo; the iteration at which it is.
fn opened(w: &mut TimeWindow, loss: impl Fn(usize) -> f64) -> u64 {
    for iteration in 1..=UNTIL {
        let photo = w.draw(3, iteration);
        w.note(photo, loss(photo));
        if w.looks_at(iteration) {
            w.widen(iteration);
        }
        if w.is_open() {
            return iteration;
        }
    }
    u64::MAX
}

#[test]
fn it_begins_with_the_photos_around_its_centre_and_waits() {
    let mut w = window();
    assert_eq!((w.open, w.is_open()), ([16, 24], false));
    assert!((1..100).all(|i| (16..24).contains(&w.draw(3, i))));
    w.widen(99);
    assert_eq!(w.open, [16, 24]);
    for centre in [0.0, 1.0] {
        let times: Vec<f64> = (0..40).map(f64::from).collect();
        let w = TimeWindow::new(&times, ALL, centre, [1, UNTIL]).unwrap();
        assert_eq!(w.open, if centre == 0.0 { [0, 8] } else { [32, 40] });
    }
}

#[test]
fn it_opens_at_once_where_photos_are_followed_and_in_time_where_they_are_not() {
    let easy = opened(&mut window(), |_| 0.02);
    // The nearer the end, the worse: the newest are always worse than most.
    let hard = opened(&mut window(), |photo| (photo as f64 - 19.5).abs().powi(4));
    assert!(easy < 450 && hard > 900 && hard <= UNTIL, "{easy} {hard}");
    // One end waits, the other does not.
    let mut w = window();
    for i in 1..400 {
        let photo = w.draw(3, i);
        w.note(photo, if photo < 14 { 1.0 } else { 0.02 });
        w.widen(i);
    }
    assert!(w.open[0] > 5 && w.open[1] == 40, "{:?}", w.open);
}

#[test]
fn half_of_the_draws_are_of_the_newest() {
    let mut w = window();
    w.open = [4, 36];
    let newest = (200..2200)
        .filter(|&i| {
            let p = w.draw(3, i);
            !(7..33).contains(&p)
        })
        .count();
    // Half, and the share of the newest among the others.
    assert!((1100..1280).contains(&newest), "{newest}");
}

#[test]
fn a_checkpoint_keeps_it() {
    let mut w = window();
    for i in 1..300 {
        let photo = w.draw(3, i);
        w.note(photo, 0.02 + 1e-3 * photo as f64);
        w.widen(i);
    }
    let mut saved = Saved::default();
    w.save(&mut saved);
    let mut again = window();
    again.restore(&saved, 300).unwrap();
    assert_eq!(again, w);
    let mut old = window();
    old.restore(&Saved::default(), 99).unwrap();
    assert_eq!(old, window());
    old.restore(&Saved::default(), UNTIL).unwrap();
    assert!(old.is_open());
}

#[test]
fn a_checkpoint_that_does_not_fit_is_named() {
    for (open, name) in [([17, 24], "window.open"), ([16, 41], "window.open"), ([16, 24], "window.loss")] {
        let mut saved = Saved::default();
        window().save(&mut saved);
        saved.put_indices("window.open", vec![2], &open);
        if name == "window.loss" {
            saved.put_floats(name, vec![1], &[0.0]);
        }
        let error = window().restore(&saved, 300).unwrap_err().to_string();
        assert!(error.contains(name), "{error}");
    }
}

#[test]
fn one_time_or_few_photos_have_none() {
    assert!(TimeWindow::new(&[0.5; 40], ALL, 0.5, [1, UNTIL]).is_none());
    assert!(TimeWindow::new(&[0.0, 1.0], ALL, 0.5, [1, UNTIL]).is_none());
    assert!(TimeWindow::new(&[0.0, 1.0], ALL, 0.5, [1, 0]).is_none());
}

#[test]
fn photos_kept_aside_are_not_drawn() {
    let times: Vec<f64> = (0..40).map(|i| f64::from(i) / 39.0).collect();
    let mut w = TimeWindow::new(&times, KeptAside::new(40, UNTIL), 0.5, [100, UNTIL]).unwrap();
    let mut drawn = [0; 40];
    for i in 1..=UNTIL {
        w.widen(i);
        drawn[w.draw(7, i)] += 1;
    }
    assert!(w.is_open());
    let never: Vec<usize> = (0..40).filter(|&photo| drawn[photo] == 0).collect();
    assert_eq!(never, [4, 12, 20, 28, 36]);
}
