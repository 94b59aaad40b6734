//! `transforms*.json`: intrinsics, poses, times, sizes, damage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use glam::DVec3;

use super::*;

const POSE: &str = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";

fn parse(text: &str, size: Option<[u32; 2]>) -> Result<CameraSet> {
    transforms::parse(text.as_bytes(), Path::new("/nowhere/t.json"), size)
}

fn one(top: &str, frame: &str) -> String {
    format!("{{{top} \"frames\": [{{{frame} \"file_path\": \"./r_0\", \"transform_matrix\": {POSE}}}]}}")
}

#[test]
fn the_camera_is_opencv_inside() {
    let set = parse(&one("\"camera_angle_x\": 0.6911112,\"w\":800,\"h\":600,", "\"time\":0.25,"), None).unwrap();
    let camera = &set.cameras[0];
    // OpenGL's camera at (1,2,3) looks along −z with +y up.
    assert_eq!(camera.position, DVec3::new(1.0, 2.0, 3.0));
    let seen = camera.world_to_camera().transform_point3(DVec3::new(1.5, 2.25, -7.0));
    assert!((seen - DVec3::new(0.5, -0.25, 10.0)).length() < 1.0e-14, "{seen}");
    let f = 400.0 / (0.5 * 0.6911112f64).tan();
    assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (f, f, 400.0, 300.0));
    assert_eq!((camera.time, camera.name.as_str()), (0.25, "./r_0"));
    assert!(set.warnings.is_empty() && set.source == "/nowhere/t.json");
}

#[test]
fn intrinsics_follow_the_order_frame_then_top_and_pixels_then_angle() {
    let size = "\"w\":200,\"h\":100,";
    let camera =
        |top: &str, frame: &str, over| parse(&one(&format!("{size}{top}"), frame), over).unwrap().cameras.remove(0);
    let focal = |top: &str, frame: &str| {
        let c = camera(top, frame, None);
        (c.fx, c.fy, c.cx, c.cy)
    };
    let angle = "\"camera_angle_x\":1.5707963267948966,";
    let near = |a: f64, b: f64| (a - b).abs() < 1.0e-12;
    assert!(near(focal(angle, "").0, 100.0));
    assert_eq!(focal(angle, "\"fl_x\":7,"), (7.0, 7.0, 100.0, 50.0));
    assert_eq!(focal("\"fl_x\":7,\"fl_y\":8,\"camera_angle_x\":1,", "\"cx\":1.5,\"cy\":2,"), (7.0, 8.0, 1.5, 2.0));
    assert!(near(focal("\"fl_x\":7,", angle).0, 100.0));
    assert!(near(focal(angle, "\"camera_angle_x\":1,\"camera_angle_y\":1.5707963267948966,").1, 50.0));
    // Another size: pixels scale with the axis, an angle keeps square pixels.
    let c = camera("\"fl_x\":7,\"fl_y\":8,\"cx\":10,", "", Some([400, 100]));
    assert_eq!((c.width, c.height, c.fx, c.fy, c.cx, c.cy), (400, 100, 14.0, 8.0, 20.0, 50.0));
    let c = camera(angle, "", Some([400, 100]));
    assert!(near(c.fx, 200.0) && near(c.fy, 200.0));
    let distorted = parse(&one(size, "\"fl_x\":7,\"k1\":0.1,"), None).unwrap();
    assert!(distorted.warnings.iter().any(|w| w.contains("undistorted")), "{:?}", distorted.warnings);
}

#[test]
fn missing_times_are_uniform() {
    let frame = format!("{{\"transform_matrix\":{POSE}}}");
    let text = format!("{{\"fl_x\":5,\"w\":8,\"h\":8,\"frames\":[{frame},{frame},{frame}]}}");
    let set = parse(&text, None).unwrap();
    assert_eq!(set.cameras.iter().map(|c| c.time).collect::<Vec<_>>(), [0.0, 0.5, 1.0]);
    assert!(set.warnings[0].contains("3 of 3 frames have no `time`"));
    assert_eq!(parse(&one("\"fl_x\":5,\"w\":8,\"h\":8,", ""), None).unwrap().cameras[0].time, 0.0);
}

#[test]
fn the_size_comes_from_the_image_when_the_file_has_none() {
    let folder = tempfile::tempdir().unwrap();
    for (name, width) in [("a.png", 12), ("b.jpg", 14), ("c.d", 16)] {
        let picture = image::RgbImage::new(width, 7);
        let format = if name == "b.jpg" { image::ImageFormat::Jpeg } else { image::ImageFormat::Png };
        picture.save_with_format(folder.path().join(name), format).unwrap();
    }
    let frame = |name: &str| format!("{{\"file_path\":\"./{name}\",\"time\":0,\"transform_matrix\":{POSE}}}");
    let frames = ["a", "b", "c.d"].map(frame).join(",");
    let file = folder.path().join("transforms_train.json");
    std::fs::write(&file, format!("{{\"camera_angle_x\":1,\"frames\":[{frames}]}}")).unwrap();
    let set = load_cameras(folder.path(), None, None).unwrap();
    assert_eq!(set.cameras.iter().map(|c| (c.width, c.height)).collect::<Vec<_>>(), [(12, 7), (14, 7), (16, 7)]);
    assert!(set.warnings[0].contains("no transforms_test.json, using"), "{:?}", set.warnings);
    assert_eq!(load_cameras(&file, None, Some([5, 6])).unwrap().cameras[0].width, 5);
    let message = load_cameras(folder.path(), Some("test"), None).unwrap_err().to_string();
    assert!(message.contains("found transforms_train.json, expected transforms_test.json"), "{message}");
    let message = parse(&one("\"fl_x\":5,", ""), None).unwrap_err().to_string();
    assert!(message.contains("frame 0 key `w`: found no size and no image `./r_0`"), "{message}");
    assert_eq!(parse(&one("\"fl_x\":5,", ""), Some([9, 9])).unwrap().cameras[0].fx, 5.0);
    assert!(matches!(load_cameras(&file, None, Some([0, 6])), Err(Error::Usage { .. })));
    assert!(matches!(load_cameras(&folder.path().join("none"), None, None), Err(Error::Io { .. })));
}

#[test]
fn bad_values_name_frame_and_key() {
    let ok = "\"fl_x\":5,\"w\":8,\"h\":8,";
    let pose = |matrix: &str| {
        format!(
            "{{{ok}\"frames\":[{{\"time\":0,\"transform_matrix\":{POSE}}},{{\"time\":0,\"transform_matrix\":{matrix}}}]}}"
        )
    };
    for (text, expected) in [
        (pose("[[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"), "frame 1 key `transform_matrix[0][0]`: found NaN"),
        (pose("[[1,0,0,-Infinity],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"), "frame 1 key `transform_matrix[0][3]`: found NaN"),
        (pose("[[1,0,0,\"a\"],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"), "found `\"a\"`"),
        (pose("[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]"), "frame 1 key `transform_matrix`: found determinant -1"),
        (pose("[[1,0.1,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"), "from orthonormal"),
        (pose("[[1,0,0,0],[0,2,0,0],[0,0,1,0],[0,0,0,1]]"), "from orthonormal"),
        (pose("[[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]"), "determinant 0"),
        (pose("[[1e200,0,0,0],[0,1e200,0,0],[0,0,1e200,0],[0,0,0,1]]"), "determinant inf"),
        (pose("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]"), "`transform_matrix[3]`"),
        (pose("[[1,0,0],[0,1,0],[0,0,1]]"), "`transform_matrix[0]`"),
        (pose("[1,2]"), "expected 4 rows"),
        (pose("null"), "frame 1 key `transform_matrix`: found `null`"),
        (format!("{{{ok}\"frames\":[{{\"time\":0}}]}}"), "`transform_matrix`: found nothing"),
        (one(ok, "\"time\":NaN,"), "frame 0 key `time`: found `null`"),
        (one(ok, "\"time\":\"soon\","), "frame 0 key `time`: found `\"soon\"`"),
        (one("\"fl_x\":-5,\"w\":8,\"h\":8,", ""), "frame 0 key `fl_x`: found `-5`"),
        (one("\"fl_x\":0,\"w\":8,\"h\":8,", ""), "frame 0 key `fl_x`"),
        (one("\"camera_angle_x\":3.2,\"w\":8,\"h\":8,", ""), "`camera_angle_x`: found 3.2"),
        (one("\"w\":8,\"h\":8,", ""), "`camera_angle_x`: found neither it nor `fl_x`"),
        (one("\"fl_x\":5,\"w\":8.5,\"h\":8,", ""), "`w`: found 8.5"),
        (one("\"fl_x\":5,\"w\":80000,\"h\":8,", ""), "`w`: found 80000"),
        (one("\"fl_x\":5,\"w\":8,", ""), "`h`: found only `w`"),
        (one("\"fl_x\":5,\"w\":8,\"h\":8,\"cx\":[],", ""), "`cx`: found `[]`"),
        ("{\"frames\":[]}".into(), "key `frames`: found `[]`"),
        ("{}".into(), "key `frames`: found nothing"),
        ("{\"frames\":[5]}".into(), "frame 0: found `5`"),
        ("[]".into(), "line 1 column 0"),
        ("{\"frames\":[1e999]}".into(), "line 1 column"),
    ] {
        let message = parse(&text, None).unwrap_err().to_string();
        assert!(message.contains(expected), "{expected} not in: {message}\n{text}");
    }
    let scaled = parse(&pose("[[3,0,0,7],[0,3,0,0],[0,0,3,0],[0,0,0,1]]"), None).unwrap();
    assert!(scaled.cameras[1].rotation == scaled.cameras[0].rotation && scaled.cameras[1].position.x == 7.0);
    assert!(scaled.warnings[0].contains("1 of 2 poses contain a scale"), "{:?}", scaled.warnings);
}

#[test]
fn a_cut_at_every_byte_is_an_error() {
    let text = one("\"camera_angle_x\": 0.69,\"w\":800,\"h\":600,", "\"time\":0.25,");
    for cut in 0..text.len() {
        assert!(parse(&text[..cut], None).is_err(), "cut at {cut}");
    }
    let deep = format!("{{\"frames\":{}", "[".repeat(1_000_000));
    assert!(parse(&deep, None).unwrap_err().to_string().contains("recursion limit"));
}

#[test]
fn poses_become_exact_rotations() {
    let angle = 0.3f64;
    let (s, c) = angle.sin_cos();
    // Rounded to six digits, as files are.
    let round = |v: f64| (v * 1.0e6).round() / 1.0e6;
    let m = glam::DMat3::from_cols(DVec3::new(round(c), round(s), 0.0), DVec3::new(-round(s), round(c), 0.0), DVec3::Z);
    let (r, scale) = transforms::rigid(m).unwrap();
    let gram = r.transpose() * r;
    assert!(
        gram.to_cols_array().iter().zip(glam::DMat3::IDENTITY.to_cols_array()).all(|(a, b)| (a - b).abs() < 1.0e-15)
    );
    assert!((scale - 1.0).abs() < 1.0e-6);
    assert!(r.to_cols_array().iter().zip(m.to_cols_array()).all(|(a, b)| (a - b).abs() < 2.0e-6));
}
