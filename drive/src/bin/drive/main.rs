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
use supple::util::terminal;
use supple_drive::live::Live;
use supple_drive::message::Message;
use supple_drive::publisher::{Publisher, Updates};
use supple_drive::request::{Hello, MOST_PULL_N, MOST_PUSH_M_S, MOST_PUSH_N_S};
use supple_drive::server::Server;
use supple_drive::{replay, viewer_stream};

/// Length of the message queue: enough for the seconds in which a scene is built.
const QUEUE: usize = 512;

fn main() -> ExitCode {
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
    let session = tempfile::tempfile().context("cannot create the session's file in the folder for temporary files")?;
    let (to_robots, messages) = sync_channel(QUEUE);
    let live = Live::new(setup, cache, args.keep.clone(), session, to_robots.clone())?;
    serve(args, live.updates(), to_robots, || live.run(&messages))
}

fn watch(args: &Args, session: &Path) -> anyhow::Result<()> {
    let playback = replay::begin(session)?;
    let publisher = Publisher::new(&playback.world);
    let (to_robots, messages) = sync_channel(QUEUE);
    serve(args, publisher.updates(), to_robots, || replay::watch(session, playback, publisher, &messages))
}

/// Serves pages and viewers while `play` runs.
fn serve(
    args: &Args,
    updates: Updates,
    to_robots: SyncSender<Message>,
    play: impl FnOnce() -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let at = || format!("cannot listen on port {} of {}; choose another port with --port", args.port, args.bind);
    let server = runtime.block_on(Server::bind(args.bind, args.port)).with_context(at)?;
    let url = server.url();
    if let Some(viewer) = args.connect.clone() {
        let (updates, runtime, to_robots) = (updates.shown.subscribe(), runtime.handle().clone(), to_robots.clone());
        std::thread::spawn(move || {
            if let Err(error) = viewer_stream::to_viewer(updates, &runtime, viewer) {
                terminal::note(format_args!("warning: {error}"));
                // The robots may have ended.
                let _ = to_robots.send(Message::Notice(error.to_string()));
            }
        });
    }
    runtime.spawn(server.serve(to_robots.clone(), updates, hello(args)));
    ctrlc::set_handler(move || drop(to_robots.send(Message::Stop))).context("cannot catch Ctrl-C")?;

    terminal::print(format_args!("{url}\n"))?;
    if !args.no_open && webbrowser::open(&url).is_err() {
        terminal::note("cannot open a browser: open the address above yourself; Ctrl-C ends");
    }
    let played = play();
    runtime.shutdown_background();
    played
}

/// Returns the first set-up: policies, robots, scene and seed.
fn setup(args: &Args, cache: &mut AgentCache) -> anyhow::Result<Setup> {
    let first = args.policy.as_deref().unwrap_or("compliant");
    let second = match args.compare.as_deref() {
        Some("none") => None,
        Some(name) => Some(name),
        None => args.policy.is_none().then_some("baseline"),
    };
    let names = [Some(first), second].into_iter().flatten();
    let robots = names.map(|name| cache.find(name, args.model.as_deref())).collect::<Result<_, _>>()?;
    Ok(Setup { scene: args.scene, seed: args.seed, robots })
}

fn hello(args: &Args) -> Hello {
    Hello {
        policies: shipped::EMBEDDED.iter().map(|(name, _)| (*name).to_owned()).collect(),
        scenes: SceneKind::value_variants().to_vec(),
        most: [MOST_PUSH_M_S, MOST_PUSH_N_S, MOST_PULL_N],
        viewer: args.connect.is_none(),
    }
}

fn replay_headless(session: &Path, recording: Option<&Path>) -> anyhow::Result<()> {
    let replayed = replay::play(SavedSession::load(session)?, recording, |_, _| ())?;
    let falls: Vec<String> = replayed.falls.iter().map(ToString::to_string).collect();
    let steps = replayed.steps;
    terminal::print(format_args!("{:.2} s shown, {steps} steps, falls: {}\n", replayed.shown_s, falls.join(", ")))?;
    replayed.recordings.iter().for_each(|path| terminal::note(format_args!("recorded {}", path.display())));
    match replayed.is_as_it_was {
        Some(true) => terminal::print("the final state matches the original bit for bit\n")?,
        Some(false) => anyhow::bail!(
            "the final state differs from the original: this build or machine computes differently, or the session was edited"
        ),
        None => terminal::note("note: the session was cut off: there is no final state to compare with"),
    }
    Ok(())
}
