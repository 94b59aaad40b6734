//! Selections.

use super::*;
use crate::edit::select::{Criterion, Depth, Likeness, View, click, lasso, rectangle, select, similar};
use crate::scene::{Gaussians, Motion, SuperpointDeformation, Superpoints};

fn chosen(mask: &[bool]) -> Vec<usize> {
    (0..mask.len()).filter(|&i| mask[i]).collect()
}

/// Three opaque discs behind one another on the view axis, and one beside them.
fn discs() -> Scene {
    let mean = vec![[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 0.0, 5.0], [1.5, 0.0, 1.0]];
    let n = mean.len();
    let gaussians = Gaussians {
        mean,
        log_scale: vec![[-1.5; 3]; n],
        rotation: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logit: vec![6.0; n],
        sh_degree: 0,
        sh: vec![0.5; 3 * n],
        ..Gaussians::default()
    };
    Scene { gaussians, ..Scene::default() }
}

fn front() -> Camera {
    Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, [200, 150])
}

#[test]
fn picks_take_the_surface_or_what_is_behind_it() {
    let scene = discs();
    let camera = front();
    let view = View { scene: &scene, camera: &camera, time: 0.0, hidden: None };
    let at = |point, depth| chosen(&click(&view, point, depth).unwrap());
    assert_eq!(at([100.0, 75.0], Depth::Surface), [1]);
    assert_eq!(at([100.0, 75.0], Depth::Behind(2.5)), [0, 1]);
    assert_eq!(at([100.0, 75.0], Depth::Behind(f64::INFINITY)), [0, 1, 2]);
    assert!(click(&view, [2.0, 2.0], Depth::Surface).unwrap_err().to_string().contains("nothing at"));
    assert!(click(&view, [200.0, 75.0], Depth::Surface).is_err());
    let within = |corners, depth| chosen(&rectangle(&view, corners, depth).unwrap());
    assert_eq!(within([95.0, 70.0, 105.0, 80.0], Depth::Surface), [1]);
    assert_eq!(within([105.0, 80.0, 95.0, 70.0], Depth::Behind(f64::INFINITY)), [0, 1, 2]);
    assert_eq!(within([95.0, 70.0, 105.0, 80.0], Depth::Behind(2.5)), [0, 1]);
    assert_eq!(within([0.0, 0.0, 200.0, 150.0], Depth::Behind(f64::INFINITY)), [0, 1, 2, 3]);
    let error = rectangle(&view, [300.0, 0.0, 400.0, 9.0], Depth::Surface).unwrap_err();
    assert!(error.to_string().contains("200x150"), "{error}");
    // Hidden Gaussians are looked through.
    let hidden = View { hidden: Some(&[false, true, false, false]), ..view };
    assert_eq!(chosen(&click(&hidden, [100.0, 75.0], Depth::Surface).unwrap()), [0]);
}

#[test]
fn a_lasso_takes_what_lies_within_its_line() {
    let (scene, camera) = (discs(), front());
    let view = View { scene: &scene, camera: &camera, time: 0.0, hidden: None };
    let within = |points: &[[f64; 2]], depth| chosen(&lasso(&view, points, depth).unwrap());
    let (surface, through) = (Depth::Surface, Depth::Behind(f64::INFINITY));
    let square = [[95.0, 70.0], [105.0, 70.0], [105.0, 80.0], [95.0, 80.0]];
    assert_eq!(within(&square, surface), [1]);
    assert_eq!(within(&square, through), [0, 1, 2]);
    // A line that turns in leaves out the middle; its box has everything.
    let horseshoe = [
        [20.0, 20.0],
        [190.0, 20.0],
        [190.0, 130.0],
        [120.0, 130.0],
        [120.0, 40.0],
        [60.0, 40.0],
        [60.0, 130.0],
        [20.0, 130.0],
    ];
    assert_eq!(within(&horseshoe, through), [3]);
    assert!(lasso(&view, &[[300.0, 0.0], [320.0, 0.0], [310.0, 9.0]], surface).is_err());
}

/// A rectangle looks at few of the Gaussians at each pixel, a click at all.
#[test]
fn a_rectangle_takes_what_clicks_on_its_pixels_take() {
    let scene = moving_scene(3000, 9, 5, 4, false);
    let view = View { scene: &scene, camera: &front(), time: 0.3, hidden: None };
    let found = rectangle(&view, [80.0, 55.0, 120.0, 95.0], Depth::Surface).unwrap();
    let mut clicked = vec![false; scene.gaussians.len()];
    for (x, y) in (80..120).flat_map(|x| (55..95).map(move |y| (f64::from(x), f64::from(y)))) {
        let Ok(one) = click(&view, [x, y], Depth::Surface) else { continue };
        clicked.iter_mut().zip(one).for_each(|(all, one)| *all |= one);
    }
    assert!(chosen(&clicked).len() > 20, "{}", chosen(&clicked).len());
    assert_eq!(chosen(&found), chosen(&clicked));
}

#[test]
fn properties_select() {
    let mut scene = discs();
    (scene.gaussians.opacity_logit[2], scene.gaussians.log_scale[3]) = (-3.0, [-4.0, -4.0, 0.5]);
    scene.gaussians.sh[..3].copy_from_slice(&[1.772_453_9, -1.772_453_9, -1.772_453_9]);
    let by = |c: Criterion| chosen(&select(&scene, &c, 0.0, &[front()]).unwrap());
    assert_eq!(by(Criterion::Opacity([0.0, 0.5])), [2]);
    assert_eq!(by(Criterion::Size([1.0, 9.0])), [3]);
    assert_eq!(by(Criterion::Color(DVec3::X, 0.1)), [0]);
    assert_eq!(by(Criterion::Sphere(DVec3::new(0.0, 0.0, 1.0), 1.1)), [0, 1]);
    assert_eq!(by(Criterion::Box(DVec3::new(1.0, -1.0, -1.0), DVec3::splat(2.0))), [3]);
    assert_eq!(by(Criterion::Floaters(4.5)), [1]);
    assert_eq!(by(Criterion::Gaussians(vec![[0, 1], [3, 3]])), [0, 1, 3]);
    for wrong in
        [Criterion::Gaussians(vec![[0, 4]]), Criterion::Gaussians(vec![[2, 1]]), Criterion::Superpoints(vec![[0, 0]])]
    {
        assert!(select(&scene, &wrong, 0.0, &[]).is_err());
    }
    let error = select(&scene, &Criterion::Floaters(4.5), 0.0, &[]).unwrap_err();
    assert!(error.to_string().contains("--data"), "{error}");
    let grown = select::grow(&scene, &[true, false, false, false], 2.05, 0.0).unwrap();
    assert_eq!(chosen(&grown), [0, 1, 3]);
}

#[test]
fn selections_combine_and_keep_their_names() {
    let mut session = Session::new(scene(), Vec::new(), BOUND_PX);
    let mut count = |script: &str| {
        let steps: Vec<Step> = script::parse(script).unwrap().iter().map(|c| session.apply(c).unwrap()).collect();
        steps.last().unwrap().selected
    };
    assert_eq!(count("select gaussians 0-99; name low; select gaussians 50-149"), 100);
    assert_eq!(count("intersect named low"), 50);
    assert_eq!(count("add gaussians 200-209"), 60);
    assert_eq!(count("subtract named low"), 10);
    assert_eq!(count("invert"), 290);
    assert_eq!(count("select gaussians 0-9; delete; select named low"), 90);
    assert_eq!(count("duplicate"), 90);
    assert_eq!(count("select named low"), 90);
    let error = session.apply(&script::parse("select named high").unwrap()[0]).unwrap_err();
    assert!(error.to_string().contains("low"), "{error}");
}

/// A row of superpoints: the first five turn as one body, the others as another.
#[test]
fn what_moves_alike_is_found() {
    let count = 10_u32;
    let g = crate::scene::synthetic::random_gaussians(200, 3, 0);
    let mean: Vec<[f32; 3]> = (0..200).map(|i| [(i / 20) as f32 * 0.2, (i % 20) as f32 * 0.01, 0.0]).collect();
    let gaussians = Gaussians { mean, ..g };
    let superpoints = Superpoints {
        of_gaussian: (0..200).map(|i| i / 20).collect(),
        position: (0..count).map(|j| [j as f32 * 0.2, 0.1, 0.0]).collect(),
    };
    let times: Vec<f32> = (0..9).map(|k| k as f32 / 8.0).collect();
    let pose = |t: f32, j: u32| {
        let noise = 1e-4 * ((j * 7) as f32).sin() * t;
        if j < 5 { [0.0, 0.0, t + noise] } else { [0.0, -0.5 * t + noise, 0.0] }
    };
    let rotation = times.iter().flat_map(|&t| (0..count).map(move |j| pose(t, j))).collect();
    let table = Motion { rotation, translation: vec![[0.0; 3]; 90], times };
    let scene = Scene {
        gaussians,
        deformation: SuperpointDeformation::of_table(superpoints, table).into(),
        ..Scene::default()
    };
    let bound = Bound::new(&scene, &[], 0.1).unwrap();
    let from = |j: u32| -> Vec<bool> { scene.deformation.superpoint_of_gaussian().iter().map(|k| *k == j).collect() };
    for most in [Likeness::World(0.01), Likeness::Pixels(5.0)] {
        let one = similar(&scene, &from(1), most, &bound).unwrap();
        assert_eq!(chosen(&one), (0..100).collect::<Vec<_>>(), "{most:?}");
        let other = similar(&scene, &from(8), most, &bound).unwrap();
        assert_eq!(chosen(&other), (100..200).collect::<Vec<_>>(), "{most:?}");
    }
    let strict = similar(&scene, &from(1), Likeness::World(1e-7), &bound).unwrap();
    assert_eq!(chosen(&strict).len(), 20);
    assert_eq!(chosen(&similar(&scene, &from(1), Likeness::World(100.0), &bound).unwrap()).len(), 200);
    assert!(similar(&discs(), &[true; 4], Likeness::World(1.0), &bound).is_err());
}

/// Half a million Gaussians. Prints times; what it asserts is what a slow machine under load still reaches.
#[test]
fn half_a_million_gaussians_are_edited_at_once() {
    let mut history = History::new(Session::new(moving_scene(500_000, 512, 65, 3, false), Vec::new(), BOUND_PX));
    let script = "select sphere 0,0,0 0.7 time 0.4; invert; move 0,0.1,0; rotate z 30; move 0,0.1,0 frame part; scale 1.1; \
                  recolor tint #ff8800; select opacity below 0.2; grow 0.01; duplicate; time reverse; delete";
    for command in script::parse(script).unwrap() {
        let start = std::time::Instant::now();
        history.run(std::slice::from_ref(&command)).unwrap();
        let time = start.elapsed();
        println!("{:6.1} ms  {}", time.as_secs_f64() * 1e3, command.text);
        assert!(time.as_secs() < 20, "{}: {time:?}", command.text);
    }
    let start = std::time::Instant::now();
    while history.undo().is_some() {}
    println!("{:6.1} ms  to undo them all", start.elapsed().as_secs_f64() * 1e3);
}
