//! Pictures of small scenes. Where no OpenGL without a screen is installed, the tests say so and pass.

use supple::mujoco::{Camera, LARGEST_PICTURE, MOST_MARKS, Mark, MarkShape, Model, Renderer};

const WORLD: [f32; 7] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
const CAMERA: Camera = Camera { target: [0.0; 3], distance_m: 1.0, azimuth_deg: 90.0, elevation_deg: 0.0 };

fn model(body: &str) -> Model {
    Model::from_xml(&[("m.xml", &format!("<mujoco><worldbody>{body}</worldbody></mujoco>"))]).unwrap()
}

/// Returns a renderer, or `None` after a note where no picture can be drawn.
fn renderer(body: &str, size: [usize; 2]) -> Option<Renderer> {
    Renderer::new(model(body), size).inspect_err(|error| println!("skipped: {error}")).ok()
}

/// Returns the mean of each colour over the columns and rows of a picture.
fn mean(picture: &[u8], width: usize, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> [f64; 3] {
    let count = (columns.len() * rows.len()) as f64;
    let mut sum = [0.0; 3];
    for (row, column) in rows.flat_map(|row| columns.clone().map(move |column| (row, column))) {
        (0..3).for_each(|k| sum[k] += f64::from(picture[3 * (row * width + column) + k]) / count);
    }
    sum
}

#[test]
fn bodies_are_drawn_at_their_poses_and_marks_in_their_colours() {
    let body = r#"<body name="b"><freejoint/><geom size="0.05" rgba="1 0 0 1"/></body>"#;
    // An odd width: rows that are padded would shear the picture.
    let Some(mut renderer) = renderer(body, [63, 48]) else { return };
    // The camera looks along y: x is to the right, z up.
    let ball = [0.2, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0];
    let (from, to) = ([-0.3, 0.0, -0.2], [-0.1, 0.0, -0.2]);
    let rod = Mark { shape: MarkShape::Rod, from, to, radius_m: 0.05, rgba: [0.0, 0.0, 1.0, 1.0] };
    let picture = renderer.picture(&[WORLD, ball], &CAMERA, &[rod]).unwrap();
    assert_eq!(picture.len(), 3 * 63 * 48);
    let [upper_right, lower_left] = [mean(&picture, 63, 40..46, 10..14), mean(&picture, 63, 17..23, 34..38)];
    assert!(upper_right[0] > 80.0 && upper_right[2] < 30.0, "{upper_right:?}");
    assert!(lower_left[2] > 80.0 && lower_left[0] < 30.0, "{lower_left:?}");
    assert_eq!(picture, renderer.picture(&[WORLD, ball], &CAMERA, &[rod]).unwrap());
    let arrows = [Mark { shape: MarkShape::Arrow, ..rod }; MOST_MARKS + 20];
    let error = renderer.picture(&[WORLD, ball], &CAMERA, &arrows).unwrap_err();
    assert!(error.to_string().contains("too many marks"), "{error}");
}

#[test]
fn two_renderers_do_not_disturb_one_another() {
    let ball = |colour: &str| format!(r#"<geom size="0.3" rgba="{colour} 1"/>"#);
    let (red, green) = (renderer(&ball("1 0 0"), [16, 16]), renderer(&ball("0 1 0"), [32, 16]));
    let (Some(mut red), Some(mut green)) = (red, green) else { return };
    for _ in 0..2 {
        let [r, g] = [(&mut red, 16), (&mut green, 32)].map(|(renderer, width)| {
            mean(&renderer.picture(&[WORLD], &CAMERA, &[]).unwrap(), width, width / 2 - 1..width / 2 + 1, 7..9)
        });
        assert!(r[0] > 3.0 * r[1] && (g[1] > 3.0 * g[0]), "{r:?} {g:?}");
    }
    drop(red);
    green.picture(&[WORLD], &CAMERA, &[]).unwrap();
}

#[test]
fn sizes_out_of_range_are_refused() {
    for size in [[0, 10], [10, 0], [LARGEST_PICTURE + 1, 10]] {
        let error = Renderer::new(model(""), size).unwrap_err();
        assert!(error.to_string().contains("expected 1x1 to 4096x4096"), "{error}");
    }
}
