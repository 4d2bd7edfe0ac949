/*! Latency and load of `drive`: simulated against real time, from a message to motion, and memory over time.

```sh
cargo bench -p supple-drive --bench live -- --scene ball-pit --seconds 60          # with a viewer that reads
cargo bench -p supple-drive --bench live -- --scene flat --seconds 1200 --chromium # with rerun's viewer in headless Chromium
```

The benchmark starts the real program and drives it over its sockets. A *command* is a message with another velocity,
sent at a random moment. It *takes effect* with the first state that contains it; that step's joint targets act 30 ms
later, as on the robot, so *motion* is in the step after it (`a_command_moves_a_robot_in_the_second_frame_after_it`).
Both times are taken when the state has been read from the socket.
*/

#[path = "../tests/common/chromium.rs"]
mod chromium;
#[path = "../tests/common/mod.rs"]
mod common;

use std::time::{Duration, Instant};

use clap::Parser;
use common::{Drive, Page};
use rand::RngExt;
use serde_json::json;
use tungstenite::Message;

/// Measures latency, speed and memory of a running `drive`.
#[derive(Parser)]
struct Args {
    /// Name of the scene
    #[arg(long, default_value = "ball-pit")]
    scene: String,
    /// Duration of the measurement (s)
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Run without a viewer
    #[arg(long)]
    blind: bool,
    /// Show the robots in rerun's viewer in headless Chromium
    #[arg(long)]
    chromium: bool,
    /// Flag that cargo passes to benchmarks
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() {
    let args = Args::parse();
    let folder = tempfile::tempdir().expect("a folder");
    let drive = Drive::start(folder.path(), &["--scene", &args.scene]);
    let mut page = drive.page();
    let browser = args.chromium.then(|| chromium::Chromium::open(&drive.url(), 1280, 800, true)).flatten();
    let viewer = (!args.blind && browser.is_none()).then(|| watch(&drive));
    page.send(&json!("drive"));
    // Until everything has started.
    page.ask_for([0.0; 3], Duration::from_secs(if args.chromium { 25 } else { 5 }));
    measure(&args, &drive, &mut page, browser);
    drop(drive);
    if let Some(viewer) = viewer {
        let (frames, bytes) = viewer.join().expect("a viewer");
        println!("viewer        {:.1} frames/s, {:.2} MB/s", frames / args.seconds, bytes / 1e6 / args.seconds);
    }
}

/// Runs a viewer that reads everything, and returns the number of frames and bytes.
fn watch(drive: &Drive) -> std::thread::JoinHandle<(f64, f64)> {
    let mut socket = drive.open("/view");
    std::thread::spawn(move || {
        let (mut frames, mut bytes) = (0.0, 0.0);
        while let Ok(message) = socket.read() {
            if let Message::Binary(file) = message {
                frames += 1.0;
                bytes += file.len() as f64;
                if socket.send(Message::text("shown")).is_err() {
                    break;
                }
            }
        }
        (frames, bytes)
    })
}

fn measure(args: &Args, drive: &Drive, page: &mut Page, mut browser: Option<chromium::Chromium>) {
    let mut rng = rand::rng();
    let (start, tick) = (Instant::now(), page.number("/tick"));
    let (mut effects, mut motions, mut slowest) = (Vec::new(), Vec::new(), f64::INFINITY);
    let mut memory: Vec<(f64, f64, Option<f64>)> = Vec::new();
    let mut heard = page.number("/heard") as u64;
    let (mut forward, mut next_command, mut next_look) = (0.0, Instant::now(), Instant::now());
    let mut sent: Option<(u64, Instant)> = None;
    let mut in_effect: Option<Instant> = None;
    while start.elapsed().as_secs_f64() < args.seconds {
        page.wait("a state", |_, message| message["state"].is_object().then_some(()));
        let now = Instant::now();
        if let Some(at) = in_effect.take() {
            motions.push(now.duration_since(at).as_secs_f64());
        }
        if let Some((number, at)) = sent.filter(|(number, _)| page.number("/heard") as u64 >= *number) {
            assert!(number > 0);
            effects.push(now.duration_since(at).as_secs_f64());
            (sent, in_effect) = (None, Some(at));
        }
        if let Some(rate) = page.state["rate"].as_f64() {
            slowest = slowest.min(rate);
        }
        if sent.is_none() && in_effect.is_none() && now >= next_command {
            // At any phase of the robots' step.
            std::thread::sleep(Duration::from_micros(rng.random_range(0..17_000)));
            forward = if forward > 0.0 { 0.0 } else { 0.3 };
            heard += 1;
            sent = Some((heard, Instant::now()));
            page.send(&json!({ "command": [forward, 0.0, 0.0] }));
            next_command = Instant::now() + Duration::from_millis(rng.random_range(100..200));
        }
        if now >= next_look {
            let heap = browser.as_mut().map(viewer_mb);
            memory.push((start.elapsed().as_secs_f64(), drive.memory_mb(), heap));
            next_look = now + Duration::from_secs_f64((args.seconds / 12.0).max(2.0));
        }
    }
    let rate = (page.number("/tick") - tick) / 240.0 / start.elapsed().as_secs_f64();
    println!("{} for {:.0} s, two robots", args.scene, args.seconds);
    println!("real time     {rate:.4} times, slowest 2 s {slowest:.3}");
    for (what, times) in [("takes effect", &mut effects), ("motion", &mut motions)] {
        times.sort_by(f64::total_cmp);
        let at = |fraction: f64| 1e3 * times[((times.len() - 1) as f64 * fraction).round() as usize];
        let [median, p99, worst] = [0.5, 0.99, 1.0].map(at);
        println!("{what:13} median {median:.1} ms, 99 % {p99:.1} ms, worst {worst:.1} ms, of {}", times.len());
    }
    for (time_s, mb, heap) in memory {
        let heap = heap.map_or(String::new(), |mb| format!(", the viewer's program {mb:.0} MB"));
        println!("memory        {mb:.1} MB after {time_s:.0} s{heap}");
    }
}

/// Returns the memory of the viewer in the browser [MB].
fn viewer_mb(browser: &mut chromium::Chromium) -> f64 {
    browser.value_in_viewer("window.memory?.buffer.byteLength").as_f64().unwrap_or(0.0) / f64::from(1 << 20)
}
