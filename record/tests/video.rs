//! Videos are drawn, decoded again and looked at. Where no OpenGL without a screen is installed, the tests say so and pass.

#[path = "../../tests/it/support.rs"]
mod support;

use std::path::Path;
use std::process::Command;

use openh264::decoder::Decoder;
use openh264::formats::YUVSource;
use shiguredo_mp4::bitstream::h264::{LengthSize, length_prefixed_to_annexb};
use shiguredo_mp4::boxes::SampleEntry;
use shiguredo_mp4::demux::{Input, Mp4FileDemuxer};
use support::{complaint, program, run};

const SIZE: [usize; 2] = [480, 270];
/// 0.3 s at 30 frames a second.
const FRAMES: usize = 9;

/// A decoded picture, shape (height, width, 3).
type Picture = Vec<u8>;
/// A function that decodes a file.
type Decode = fn(&[u8]) -> Vec<Picture>;

/// Plays a scenario with a video; `None` after a note where no picture can be drawn.
fn film(folder: &Path, name: &str) -> Option<Vec<u8>> {
    let line = ["push", "--at-s", "0", "--duration-s", "0.3", "--no-record", "--video-size", "480x270", "--video"];
    let output = run("scenario", folder, &[&line[..], &[name]].concat());
    let words = complaint(&output);
    if words.contains("apt-get install libegl1") {
        println!("skipped: {words}");
        return None;
    }
    assert!(output.status.success() && words.contains(name), "{words}");
    Some(std::fs::read(folder.join(name)).unwrap())
}

fn pictures_of_mp4(file: &[u8]) -> Vec<Picture> {
    let mut demuxer = Mp4FileDemuxer::new();
    demuxer.handle_input(Input { position: 0, data: file });
    let track = demuxer.tracks().unwrap()[0].clone();
    assert_eq!((track.timescale.get(), track.duration), (30, FRAMES as u64));
    let mut decoder = Decoder::new().unwrap();
    let mut pictures = Vec::new();
    while let Some(sample) = demuxer.next_sample().unwrap() {
        let mut stream = Vec::new();
        if let (true, Some(SampleEntry::Avc1(entry))) = (pictures.is_empty(), sample.sample_entry) {
            for parameters in entry.avcc_box.sps_list.iter().chain(&entry.avcc_box.pps_list) {
                stream.extend([0, 0, 0, 1].iter().chain(parameters));
            }
        }
        let data = &file[sample.data_offset as usize..][..sample.data_size];
        stream.extend(length_prefixed_to_annexb(data, LengthSize::FourBytes).unwrap());
        let yuv = decoder.decode(&stream).unwrap().unwrap();
        assert_eq!(yuv.dimensions(), (SIZE[0], SIZE[1]));
        let mut rgb = vec![0; yuv.rgb8_len()];
        yuv.write_rgb8(&mut rgb);
        pictures.push(rgb);
    }
    pictures
}

fn pictures_of_webp(file: &[u8]) -> Vec<Picture> {
    let decoder = webp_animation::Decoder::new(file).unwrap();
    assert_eq!(decoder.dimensions(), (SIZE[0] as u32, SIZE[1] as u32));
    let frames: Vec<_> = decoder.into_iter().collect();
    // The end of each frame [ms].
    assert_eq!(frames.iter().map(|frame| frame.timestamp()).collect::<Vec<_>>()[..3], [33, 66, 100]);
    let rgb = |frame: &webp_animation::Frame| frame.data().chunks(4).flat_map(|pixel| pixel[..3].to_vec()).collect();
    frames.iter().map(rgb).collect()
}

/// Returns the number of pixels of the robots' pictures with a property, on the left and on the right half.
fn count(picture: &Picture, is: impl Fn([i32; 3]) -> bool) -> [usize; 2] {
    let mut found = [0; 2];
    for (index, pixel) in picture.chunks(3).enumerate() {
        let (row, column) = (index / SIZE[0], index % SIZE[0]);
        if (30..190).contains(&row) && is([pixel[0], pixel[1], pixel[2]].map(i32::from)) {
            found[column * 2 / SIZE[0]] += 1;
        }
    }
    found
}

#[test]
fn each_format_shows_both_robots_in_their_colours() {
    let folder = tempfile::tempdir().unwrap();
    let formats: [(&str, Decode); 2] = [("a.mp4", pictures_of_mp4), ("new folder/a.webp", pictures_of_webp)];
    for (name, decode) in formats {
        let Some(file) = film(folder.path(), name) else { return };
        let pictures = decode(&file);
        assert_eq!(pictures.len(), FRAMES, "{name}");
        for picture in [&pictures[0], &pictures[FRAMES - 1]] {
            let [compliant, baseline] = count(picture, |[red, _, blue]| blue > red + 50);
            assert!(compliant > 150 && baseline < compliant / 5, "{name}: blue {compliant} {baseline}");
            let [compliant, baseline] = count(picture, |[red, _, blue]| red > blue + 50);
            assert!(baseline > 150 && compliant < baseline / 2, "{name}: orange {compliant} {baseline}");
        }
        let changed = pictures[0].iter().zip(&pictures[FRAMES - 1]).filter(|(a, b)| a.abs_diff(**b) > 40).count();
        assert!(changed > 500, "{name}: {changed}");
    }
}

#[test]
fn the_same_playback_gives_the_same_file_in_place_of_an_old_one() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.mp4"), "an old one").unwrap();
    let Some(first) = film(folder.path(), "a.mp4") else { return };
    assert_eq!(Some(first), film(folder.path(), "a.mp4"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_video_that_cannot_be_made_is_refused_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let cases: [(&str, &str, &str); 7] = [
        ("a.avi", "960x540", "a.avi: its name must end with .mp4 or .webp; name it a.mp4"),
        ("a", "960x540", "name it a.mp4"),
        ("a.mp4", "961x540", "the size of the video is 961x540 px, expected even numbers from 480x270 to 3840x2160"),
        ("a.mp4", "8000x540", "expected even numbers from 480x270"),
        ("a.mp4", "8x8", "expected even numbers from 480x270"),
        ("a.mp4", "large", "expected WIDTHxHEIGHT in pixels, as in 960x540"),
        ("file/a.mp4", "960x540", "cannot write the video file/a.mp4: "),
    ];
    for (name, size, expected) in cases {
        let line = ["walk", "--duration-s", "0.1", "--no-record", "--video", name, "--video-size", size];
        let output = run("scenario", folder.path(), &line);
        let words = complaint(&output);
        assert!(output.status.code() == Some(2) && words.contains(expected), "{name} {size}: {words}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn without_opengl_the_error_names_the_packages_to_install() {
    let folder = tempfile::tempdir().unwrap();
    let mut scenario = Command::new(program("scenario"));
    scenario.args(["walk", "--no-record", "--video", "a.mp4"]).current_dir(folder.path());
    // Hides the drivers, if there are any.
    let output = scenario.env("__EGL_VENDOR_LIBRARY_FILENAMES", "/none").output().unwrap();
    let words = complaint(&output);
    assert!(words.contains("cannot draw a picture: "), "{words}");
    assert!(words.contains("on Debian: apt-get install libegl1 libgl1-mesa-dri"), "{words}");
    assert_eq!((output.status.code(), std::fs::read_dir(folder.path()).unwrap().count()), (Some(2), 0));
}
