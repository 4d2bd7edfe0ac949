//! The program `drive`: robots driven live in a browser.

mod args;

use std::path::Path;
use std::process::ExitCode;
use std::sync::mpsc::{SyncSender, sync_channel};

use anyhow::Context;
use args::Args;
use clap::{Parser, ValueEnum};
use supple::policy::shipped;
use supple::scenario::session::{AgentCache, SavedSession, SceneKind, Setup};
use supple::util::{files, terminal};
use supple_drive::live::{self, Live};
use supple_drive::message::Message;
use supple_drive::publisher::{Publisher, Updates};
use supple_drive::request::MOST;
use supple_drive::server::{self, start_thread};
use supple_drive::{replay, viewer_stream};

/// Length of the message queue: enough for the seconds in which a scene is built.
const QUEUE: usize = 512;

fn main() -> ExitCode {
    // This also holds in the process that reads robots, as a page may name any file.
    files::refuse_pipes();
    supple::robot::isolate_imports();
    supple::announce_revision!();
    let args = Args::parse();
    terminal::conclude(match &args.replay {
        Some(session) if args.headless || args.record.is_some() => replay_headless(session, args.record.as_deref()),
        Some(session) => watch(&args, session),
        None => drive(&args),
    })
}

fn drive(args: &Args) -> anyhow::Result<()> {
    let mut cache = AgentCache::default();
    let setup = setup(args, &mut cache)?;
    let (to_robots, messages) = sync_channel(QUEUE);
    let is_shared = !args.bind.is_loopback();
    let live = Live::new(setup, cache, args.keep.clone(), live::session_file()?, to_robots.clone(), is_shared)?;
    serve(args, live.updates(), to_robots, || live.run(&messages))
}

fn watch(args: &Args, session: &Path) -> anyhow::Result<()> {
    let playback = replay::begin(session)?;
    let publisher = Publisher::new(&playback.world);
    let (to_robots, messages) = sync_channel(QUEUE);
    let to_self = to_robots.clone();
    serve(args, publisher.updates.clone(), to_robots, || {
        replay::watch(session, playback, publisher, &to_self, &messages)
    })
}

/// Serves pages and viewers while `play` runs.
fn serve(
    args: &Args,
    updates: Updates,
    to_robots: SyncSender<Message>,
    play: impl FnOnce() -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let shown = updates.shown.subscribe();
    let (url, runtime) = server::start(args.bind, args.port, to_robots.clone(), updates, hello(args))?;
    if let Some(viewer) = args.connect.clone() {
        let to_robots = to_robots.clone();
        start_thread("feeding a viewer", move || {
            if let Err(error) = viewer_stream::to_viewer(shown, &runtime, viewer) {
                terminal::note(format_args!("warning: {error}"));
                // The robots may have ended.
                let _ = to_robots.send(Message::Notice(error.to_string()));
            }
        })?;
    }
    stop_on_signals(to_robots)?;

    terminal::print(format_args!("{url}\n"))?;
    if !args.no_open && webbrowser::open(&url).is_err() {
        terminal::note("cannot open a browser: open the address above yourself; Ctrl-C ends");
    }
    play()
}

/// Handles signals: the first Ctrl-C (or SIGTERM, or SIGHUP) asks the robots to stop, the second one ends the program at
/// once, for example while a disk does not answer.
fn stop_on_signals(to_robots: SyncSender<Message>) -> anyhow::Result<()> {
    let ask = move || {
        let to_robots = to_robots.clone();
        // On another thread, because it waits while the queue is full.
        let asked = start_thread("stopping", move || drop(to_robots.send(Message::Stop)));
        asked.unwrap_or_else(|_| std::process::exit(130));
    };
    terminal::on_signals(ask, "stopped at once").context("cannot catch Ctrl-C")
}

/// Returns the first set-up: policies, robots, scene and seed.
fn setup(args: &Args, cache: &mut AgentCache) -> anyhow::Result<Setup> {
    let first = args.policy.as_deref().unwrap_or("real@0.03");
    let second = match args.compare.as_deref() {
        Some("none") => None,
        Some(name) => Some(name),
        None => args.policy.is_none().then_some("real"),
    };
    let names = [Some(first), second].into_iter().flatten();
    let robots = names.map(|name| cache.find(name, args.model.as_deref())).collect::<Result<_, _>>()?;
    Ok(Setup { scene: args.scene, seed: args.seed, robots })
}

fn hello(args: &Args) -> serde_json::Value {
    serde_json::json!({
        "policies": shipped::EMBEDDED.iter().map(|(name, _)| *name).collect::<Vec<_>>(),
        "scenes": SceneKind::value_variants(),
        "most": MOST,
        "viewer": args.connect.is_none(),
        "is_served": false,
    })
}

fn replay_headless(session: &Path, recording: Option<&Path>) -> anyhow::Result<()> {
    let replayed = replay::play(SavedSession::load(session)?, recording, || ())?;
    let falls: Vec<String> = replayed.falls.iter().map(ToString::to_string).collect();
    let steps = replayed.steps;
    terminal::print(format_args!("{:.2} s shown, {steps} steps, falls: {}\n", replayed.shown_s, falls.join(", ")))?;
    replayed.recordings.iter().for_each(|path| terminal::note(format_args!("recorded {}", path.display())));
    match replayed.verified {
        Some(Ok(())) => terminal::print("the final state matches the original bit for bit\n")?,
        Some(Err(difference)) => anyhow::bail!(difference),
        None => terminal::note("note: the session was cut off: there is no final state to compare with"),
    }
    Ok(())
}
