#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::path::Path;

use glam::DVec3;

use super::*;
use crate::data::pixels::ImageSource;
use crate::scene::Camera;

const SIDE: u32 = 8;
const BYTES: u64 = 4 * (SIDE * SIDE) as u64;

/// `count` pictures of one colour each, the one of index `missing` absent.
fn views(folder: &Path, count: usize, missing: usize) -> Arc<[View]> {
    let view = |i: usize| {
        let path = folder.join(format!("{i}.png"));
        if i != missing {
            image::RgbImage::from_pixel(SIDE, SIDE, image::Rgb([i as u8, 0, 0])).save(&path).unwrap();
        }
        let size = [SIDE, SIDE];
        let image = ImageSource { path, stored: size, size, lens: None, mask: None, used: None };
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::Y, 1.0, size);
        View { name: i.to_string(), camera, time: 0.0, image }
    };
    (0..count).map(view).collect()
}

fn colour(pixels: &Pixels) -> u32 {
    pixels.rgba[0] & 0xff
}

#[test]
fn every_budget_and_worker_count_gives_the_same_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let views = views(folder.path(), 12, usize::MAX);
    let order: Vec<usize> = (0..120).map(|i| (i * 7 + i / 12) % 12).collect();
    for budget in [0, BYTES, 3 * BYTES, 100 * BYTES] {
        for workers in [0, 1, 4] {
            let loader = ImageLoader::new(Arc::clone(&views), budget, workers).unwrap();
            for (at, &index) in order.iter().enumerate() {
                loader.prefetch(&order[at..order.len().min(at + 5)]);
                assert_eq!(colour(&loader.get(index).unwrap()), index as u32);
            }
            assert!(loader.bytes() <= budget.max((workers as u64 + 1) * BYTES), "{} of {budget}", loader.bytes());
        }
    }
}

#[test]
fn what_fits_is_decoded_once_and_what_does_not_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let views = views(folder.path(), 4, usize::MAX);
    let loader = ImageLoader::new(Arc::clone(&views), 4 * BYTES, 0).unwrap();
    let first: Vec<_> = (0..4).map(|i| loader.get(i).unwrap()).collect();
    assert!((0..4).all(|i| Arc::ptr_eq(&first[i], &loader.get(i).unwrap())));
    assert_eq!(loader.bytes(), 4 * BYTES);
    let loader = ImageLoader::new(views, 2 * BYTES, 0).unwrap();
    let (a, b) = (loader.get(0).unwrap(), loader.get(1).unwrap());
    loader.get(0).unwrap();
    loader.get(2).unwrap();
    assert!(Arc::ptr_eq(&a, &loader.get(0).unwrap()) && !Arc::ptr_eq(&b, &loader.get(1).unwrap()));
    assert_eq!(loader.bytes(), 2 * BYTES);
}

#[test]
fn a_failed_picture_names_its_file_whoever_decoded_it() {
    let folder = tempfile::tempdir().unwrap();
    let views = views(folder.path(), 3, 1);
    for workers in [0, 2] {
        let loader = ImageLoader::new(Arc::clone(&views), 100 * BYTES, workers).unwrap();
        loader.prefetch(&[0, 1, 2, 77]);
        for _ in 0..3 {
            let message = loader.get(1).unwrap_err().to_string();
            assert!(message.contains("1.png"), "{message}");
        }
        assert_eq!(colour(&loader.get(2).unwrap()), 2);
        assert!(matches!(loader.get(77), Err(Error::Usage { .. })));
    }
    let loader = ImageLoader::new(Arc::clone(&views), 100 * BYTES, 0).unwrap();
    assert!(loader.get(1).is_err());
    views[0].image.decode().unwrap();
    std::fs::copy(&views[0].image.path, &views[1].image.path).unwrap();
    assert_eq!(colour(&loader.get(1).unwrap()), 0, "a file that came back is read");
}

#[test]
fn many_threads_may_ask_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let loader = ImageLoader::new(views(folder.path(), 6, usize::MAX), 3 * BYTES, 2).unwrap();
    std::thread::scope(|scope| {
        for start in 0..4usize {
            let loader = &loader;
            scope.spawn(move || {
                for i in 0..200 {
                    let index = (start + i * 5) % 6;
                    loader.prefetch(&[(index + 5) % 6]);
                    assert_eq!(colour(&loader.get(index).unwrap()), index as u32);
                }
            });
        }
    });
}

#[test]
fn what_is_forgotten_is_decoded_again_and_counts_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let views = views(folder.path(), 3, usize::MAX);
    let loader = ImageLoader::new(views, 10 * BYTES, 1).unwrap();
    let first = loader.get(1).unwrap();
    loader.get(2).unwrap();
    loader.forget(1);
    // Neither is there.
    loader.forget(0);
    loader.forget(7);
    assert_eq!(loader.bytes(), BYTES);
    let again = loader.get(1).unwrap();
    assert!(!Arc::ptr_eq(&first, &again) && first.rgba == again.rgba);
    assert_eq!(loader.bytes(), 2 * BYTES);
}
