//! Tests that read recordings back, and tests of their failures.

use std::collections::BTreeSet;
use std::fs::File;
use std::net::TcpListener;
use std::path::Path;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use re_chunk_store::{ChunkStore, ChunkStoreConfig};
use re_sdk_types::blueprint::archetypes::{EyeControls3D, ViewContents};
use rerun::StoreKind;

use super::*;
use supple::mujoco::Data;
use supple::robot::Robot;
use supple::scenario::trace::{DisturbanceMark, EventKind, Pose, Rope, Sensed};
use supple::sim::{Buffers, Ground, HeightField, Scene};
use supple::task::{Command, Stage};

/// A robot on the plane.
static FLAT: LazyLock<Scene> = LazyLock::new(|| Scene::flat(Robot::load("go1").unwrap(), 1.0 / 240.0));

fn obstacles() -> String {
    let body = |name: &str, place: &str, shape: &str| {
        format!(r#"<body name="{name}" pos="{place}"><freejoint/><geom name="{name}" {shape}/></body>"#)
    };
    let ball = |k: usize| body(&format!("ball{k}"), &format!("1 {k} 1"), r#"type="sphere" size="0.1""#);
    (0..5).map(ball).chain([body("crate", "2 0 1", r#"type="box" size="0.1 0.1 0.1""#)]).collect()
}

fn scene(ground: Ground) -> Scene {
    let buffers = Buffers { contacts: 100, rows: 500, stack: 200_000 };
    Scene { ground, obstacles: obstacles(), buffers, ..FLAT.clone() }
}

/// Returns a frame with the poses of the scene's start and invented forces, commands and rewards.
fn frame(model: &Model, time_s: f64) -> Frame {
    let mut data = Data::new(model.try_clone().unwrap()).unwrap();
    data.step1().unwrap();
    let pose = |(position, quaternion): (&[f64], &[f64])| Pose {
        position: std::array::from_fn(|k| position[k] as f32),
        quaternion: std::array::from_fn(|k| quaternion[k] as f32),
    };
    let bodies = data.body_positions().chunks(3).zip(data.body_quaternions().chunks(4)).map(pose).collect();
    Frame {
        time_s,
        bodies,
        command: Command::velocity(0.5, 0.0, 0.0),
        velocity: [0.4, 0.0, 0.0],
        velocity_in_heading: [0.4, 0.0, 0.0],
        height_m: 0.3,
        power_w: 20.0,
        torque_n_m: 10.0,
        reward: 0.8,
        foot_positions: [[0.1, 0.1, 0.02]; 4],
        foot_forces: [[0.0, 0.0, 30.0]; 4],
        peak_foot_force_n: 40.0,
        stage: Some(Stage::Walking),
        ..Frame::default()
    }
}

/// Entities of the recording and of its layout, the contents of the layout's views, and the targets of their cameras.
struct Content {
    recorded: BTreeSet<String>,
    shown: Vec<String>,
    followed: Vec<String>,
}

fn read(path: &Path) -> Content {
    let mut content = Content { recorded: BTreeSet::new(), shown: Vec::new(), followed: Vec::new() };
    let stores = ChunkStore::from_rrd_reader(&ChunkStoreConfig::DEFAULT, &mut File::open(path).unwrap()).unwrap();
    for (id, store) in &stores {
        for chunk in store.iter_physical_chunks() {
            if id.kind() == StoreKind::Recording {
                content.recorded.insert(chunk.entity_path().to_string());
                continue;
            }
            let texts = |component, to: &mut Vec<String>| {
                to.extend(chunk.iter_slices::<String>(component).flatten().map(|text| text.to_string()));
            };
            texts(ViewContents::descriptor_query().component, &mut content.shown);
            texts(EyeControls3D::descriptor_tracking_entity().component, &mut content.followed);
        }
    }
    content
}

#[test]
fn a_recording_has_every_entity_that_its_layout_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new folder").join("two.rrd");
    let hills = Ground::Field(HeightField::sample([2.0, 2.0], 0.1, |x, y| 0.1 * (x + y).sin()).into());
    let (flat, uneven) = (scene(Ground::Flat), scene(hills));
    let models = [flat.compile_visual().unwrap(), uneven.compile_visual().unwrap()];
    let mut views = RobotView::several([("compliant", &models[0], &flat), ("the other one", &models[1], &uneven)]);
    views[0].estimates = true;
    let mut recorder = Recorder::new(Sink::File(path.clone()), "test", &views).unwrap();
    for (robot, model) in models.iter().enumerate() {
        for step in 0..40 {
            let mut frame = frame(model, f64::from(step) / 60.0);
            frame.sensed = Some(Sensed::default());
            frame.mark = match step {
                3 => Some(DisturbanceMark::Push { velocity: [0.0, 1.0, 0.0] }),
                20..30 => Some(DisturbanceMark::Rope { force: [0.0, 50.0, 0.0] }),
                _ => None,
            };
            // A rope that is tied in between, and is taken off.
            let points = vec![[0.0, 0.0, 0.3], [0.0, 3.0, 0.3]];
            frame.rope =
                (5..30).contains(&step).then(|| Rope { points, force_n: f64::from(step % 2), ..Rope::default() });
            recorder.frame(robot, &frame).unwrap();
        }
        let fall = Event { time_s: 0.7, kind: EventKind::Fall, text: "the base sank to 0.19 m".into() };
        recorder.event(robot, &fall).unwrap();
    }
    recorder.finish().unwrap();

    let Content { recorded, shown, followed } = read(&path);
    // Two views of worlds, one of the events, nine plots of both robots and four of their estimates, and the one with
    // parts twice.
    assert_eq!((shown.len(), followed.len()), (2 + 2 + (9 + 4) * 2 + 2, 2), "{shown:?} {followed:?}");
    for query in &shown {
        let path = query.strip_prefix("+ ").unwrap();
        let found = match path.strip_suffix("/**") {
            Some(root) => recorded.iter().any(|entity| entity.starts_with(root)),
            None => recorded.contains(path),
        };
        assert!(found, "{query} shows nothing of {recorded:#?}");
    }
    assert!(followed.iter().all(|entity| recorded.contains(entity)), "{followed:?}");
    let overlay = ["push", "rope", "pull", "label", "path", "foot\\ forces", "loaded\\ rope"]
        .map(|name| format!("overlay/{name}"));
    let bodies = ["trunk", "FL_calf", "crate", "scene/balls", "scene/ground"].map(str::to_owned);
    for name in bodies.iter().chain(&overlay) {
        assert!(recorded.contains(&format!("/world/compliant/{name}")), "{name} of {recorded:#?}");
    }
    assert!(!recorded.iter().any(|entity| entity.contains("ball0")), "balls are one entity");
}

#[test]
fn frames_of_another_scene_and_unknown_robots_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let model = FLAT.compile_visual().unwrap();
    let view = RobotView::new("compliant", &model, &FLAT);
    let mut recorder = Recorder::new(Sink::File(folder.path().join("a.rrd")), "test", &[view]).unwrap();
    let other = frame(&scene(Ground::Flat).compile_visual().unwrap(), 0.0);
    assert!(matches!(recorder.frame(0, &other), Err(RecordError::Bodies { expected: 14, found: 20, .. })));
    assert!(matches!(recorder.frame(1, &frame(&model, 0.0)), Err(RecordError::Robot(1, 1))));
    recorder.finish().unwrap();
}

#[test]
fn places_where_nothing_can_be_written_are_errors() {
    let model = FLAT.compile_visual().unwrap();
    let view = RobotView::new("compliant", &model, &FLAT);
    let open = |sink| Recorder::new(sink, "test", &[view]);
    for path in ["/proc/none/a.rrd", "-", "/dev/stdout"] {
        assert!(matches!(open(Sink::File(path.into())), Err(RecordError::Create(_))), "{path}");
    }
    assert!(matches!(open(Sink::Connect(Some("nonsense".into()))), Err(RecordError::Viewer(..))));
}

#[test]
fn a_recording_is_named_as_one() {
    for path in ["walk.mp4", "walk", "walk.rrd.csv"] {
        let error = check_name(Path::new(path)).unwrap_err().to_string();
        assert!(error.contains("its name ends with .rrd; name it walk.r"), "{error}");
    }
    for path in ["walk.rrd", "WALK.RRD", "new folder/a.b.rrd", "/dev/null"] {
        assert!(check_name(Path::new(path)).is_ok(), "{path}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_at_the_latest_at_the_end() {
    let model = FLAT.compile_visual().unwrap();
    let view = RobotView::new("compliant", &model, &FLAT);
    let record = || {
        let mut recorder = Recorder::new(Sink::File("/dev/full".into()), "test", &[view])?;
        recorder.frame(0, &frame(&model, 0.0))?;
        recorder.finish()
    };
    let error = record().unwrap_err();
    assert!(matches!(error, RecordError::Write(..) | RecordError::Rerun(_)), "{error}");
}

#[test]
fn a_viewer_that_stopped_reading_is_an_error_and_not_a_wait_without_end() {
    let deaf = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("rerun+http://{}/proxy", deaf.local_addr().unwrap());
    let model = FLAT.compile_visual().unwrap();
    let view = RobotView::new("compliant", &model, &FLAT);
    let start = Instant::now();
    let record = || {
        let mut recorder = Recorder::new(Sink::Connect(Some(url)), "test", &[view])?;
        for step in 0..10_000 {
            recorder.frame(0, &frame(&model, f64::from(step) / 60.0))?;
        }
        recorder.finish()
    };
    let error = record().unwrap_err();
    assert!(matches!(error, RecordError::Write(..) | RecordError::Viewer(..)), "{error}");
    assert!(start.elapsed() < Duration::from_secs(30), "{:?}", start.elapsed());
}

#[test]
fn live_recording_stays_as_large_as_it_began() {
    let scene = scene(Ground::Flat);
    let model = scene.compile_visual().unwrap();
    let view = RobotView { tint: Some(BLUE), ..RobotView::new("compliant", &model, &scene) };
    let mut recorder = Recorder::live(Sink::Memory, "test", &[view]).unwrap();
    let (mut sent, mut chunks) = (Vec::new(), Vec::new());
    for step in 0_u16..240 {
        let mut frame = frame(&model, f64::from(step) / 60.0);
        // Everything moves, and is pushed and pulled now and then.
        frame.bodies.iter_mut().for_each(|pose| pose.position[0] += 0.1 * f32::from(step));
        frame.mark = match step % 60 {
            3 => Some(DisturbanceMark::Push { velocity: [0.0, 1.0, 0.0] }),
            20..30 => Some(DisturbanceMark::Rope { force: [0.0, 50.0, 0.0] }),
            _ => None,
        };
        recorder.frame(0, &frame).unwrap();
        if step % 60 == 40 {
            let fall = Event { time_s: frame.time_s, kind: EventKind::Fall, text: "fell".into() };
            recorder.event(0, &fall).unwrap();
        }
        if step % 60 == 50 {
            recorder.begin_again(0).unwrap();
        }
        // The files one after another are a file.
        sent.extend(recorder.take().unwrap());
        if step % 60 == 59 {
            let stores = ChunkStore::from_rrd_reader(&ChunkStoreConfig::DEFAULT, &mut sent.as_slice()).unwrap();
            let viewer = stores.into_iter().find(|(id, _)| id.kind() == StoreKind::Recording).unwrap().1;
            chunks.push(viewer.iter_physical_chunks().count());
        }
    }
    assert!(chunks[0] > 10, "{chunks:?}");
    assert_eq!(chunks, [chunks[0]; 4]);
    recorder.finish().unwrap();
}

#[test]
fn clock_before_1970_is_an_error() {
    let epoch = std::time::SystemTime::UNIX_EPOCH;
    assert!(stream::check_clock(epoch).is_ok());
    let error = stream::check_clock(epoch - Duration::from_secs(1)).unwrap_err();
    assert!(error.to_string().contains("before 1970"), "{error}");
}
