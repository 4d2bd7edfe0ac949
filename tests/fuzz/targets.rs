//! The readers of files that are fuzzed, with the inputs that fuzzing starts from.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use supple::config::Config;
use supple::estimate::contact::{ContactNetwork, INPUTS};
use supple::mujoco::{self, Data, Model};
use supple::network::Scratch;
use supple::policy::onnx;
use supple::policy::{InferenceBuffers, Policy};
use supple::robot::Robot;
use supple::scenario::catalog::{DEFAULTS, Scenario};
use supple::scenario::session::{Act, AgentCache, Input, PushUnit, SavedSession, SceneKind, Setup, Writer};
use supple::sim::Scene;
use supple::sim::Sim;
use supple::task::Command;
use supple::train::Trainer;
use supple::train::checkpoint::{Checkpoint, RunState};

use crate::ROOT;

/// A reader of files.
pub struct Target {
    /// The name on the command line.
    pub name: &'static str,
    /// Makes the valid inputs that mutations start from.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Returns true if the input was accepted. Must not panic, abort, hang or take much memory.
    pub run: fn(&[u8]) -> bool,
}

impl Target {
    /// The file of the smallest inputs that reached code of their own: each after its length, in 4 bytes.
    pub fn corpus_file(&self) -> PathBuf {
        Path::new(ROOT).join("tests/fuzz/corpus/found").join(self.name)
    }

    /// Reads the inputs of [`Target::corpus_file`].
    pub fn corpus(&self) -> Vec<Vec<u8>> {
        let bytes = std::fs::read(self.corpus_file()).unwrap_or_default();
        let (mut rest, mut inputs) = (&bytes[..], Vec::new());
        while let Some((length, after)) = rest.split_first_chunk::<4>() {
            let (input, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize).expect("a whole file");
            inputs.push(input.to_vec());
            rest = after;
        }
        inputs
    }
}

/// All of them.
pub static TARGETS: [Target; 9] = [
    Target { name: "config", seeds: configs, run: config },
    Target { name: "checkpoint", seeds: checkpoints, run: checkpoint },
    Target { name: "policy", seeds: policies, run: policy },
    Target { name: "contact", seeds: contacts, run: contact },
    Target { name: "scenario", seeds: scenarios, run: scenario },
    Target { name: "onnx", seeds: networks, run: onnx_file },
    Target { name: "robot", seeds: robots, run: robot },
    Target { name: "session", seeds: sessions, run: session },
    Target { name: "mjcf", seeds: fragments, run: mjcf },
];

macro_rules! corpus {
    ($($file:literal),*) => { vec![$(include_bytes!(concat!("corpus/", $file)).to_vec()),*] };
}

fn configs() -> Vec<Vec<u8>> {
    corpus!["config/whole.yaml", "config/based.yaml", "config/odd.yaml"]
}

fn config(input: &[u8]) -> bool {
    // As a file, so that `base` is followed; the child has a folder of its own.
    std::fs::write("c.yaml", input).expect("a file");
    let Ok(config) = Config::load("c.yaml") else { return false };
    assert_eq!(Config::from_yaml("again", &config.to_yaml()).expect("what was accepted is accepted again"), config);
    true
}

fn tiny_trainer(name: &str) -> Trainer {
    let mut config = Config::load(name).expect("an embedded configuration");
    config.ppo.environments = 1;
    config.ppo.batch_size = 4;
    config.ppo.minibatch_size = 2;
    config.ppo.epochs = 1;
    config.ppo.hidden_layers = vec![2];
    if name == "real" {
        // Episodes of one step until there are pushes, and pushes from the first of them on.
        (config.episode.walking_s, config.episode.push_gate) = (0.02, 0.0);
    }
    Trainer::new("fuzz", config, 0, 1).expect("a trainer")
}

/// Those of the paper's robot and of a real one, which is pulled and whose feet are held.
fn tiny_checkpoints() -> &'static [Checkpoint; 2] {
    static MADE: OnceLock<[Checkpoint; 2]> = OnceLock::new();
    MADE.get_or_init(|| {
        ["compliant", "real"].map(|name| {
            let mut trainer = tiny_trainer(name);
            trainer.iterate().expect("an iteration");
            if name == "real" {
                // Pushes have begun with the first.
                trainer.iterate().expect("an iteration");
            }
            let mut checkpoint = trainer.checkpoint().expect("a checkpoint");
            // Else the input of a number would not be the same the next time.
            checkpoint.run.elapsed_s = 1.5;
            checkpoint
        })
    })
}

/// Files, and the part of each that its checksum guards, to be sealed again after a mutation.
fn checkpoints() -> Vec<Vec<u8>> {
    let parts = |checkpoint: &Checkpoint| {
        [checkpoint.to_bytes().expect("bytes"), serde_json::to_vec(&checkpoint.run).expect("JSON")]
    };
    tiny_checkpoints().iter().flat_map(parts).collect()
}

fn checkpoint(input: &[u8]) -> bool {
    let Ok(run) = serde_json::from_slice::<RunState>(input) else {
        return Checkpoint::from_bytes(input).is_ok();
    };
    // The networks that fit its observation.
    let [of_paper, of_real] = tiny_checkpoints();
    let learner = if run.config.pulls.is_some() { of_real.learner.clone() } else { of_paper.learner.clone() };
    let Ok(bytes) = (Checkpoint { run, learner }).to_bytes() else { return false };
    let Ok(checkpoint) = Checkpoint::from_bytes(&bytes) else { return false };
    let config = checkpoint.run.config.clone();
    if !input.len().is_multiple_of(8) {
        return true;
    }
    let Ok(mut trainer) = Trainer::resume(checkpoint, 1) else { return false };
    if config.ppo.batch_size <= 16 && config.ppo.epochs <= 4 && config.simulation.substeps() <= 16 {
        // May fail, as with weights that are not finite after it.
        let _ = trainer.iterate();
    }
    true
}

fn policies() -> Vec<Vec<u8>> {
    vec![tiny_trainer("compliant").policy().to_bytes().expect("bytes")]
}

fn policy(input: &[u8]) -> bool {
    let Ok(policy) = Policy::from_bytes(input, Path::new("fuzz")) else { return false };
    assert!(!policy.metadata_json().is_empty() && !onnx::export(&policy).is_empty());
    policy.joint_targets(&vec![0.0; policy.layout().length()], &mut InferenceBuffers::default());
    true
}

fn contacts() -> Vec<Vec<u8>> {
    vec![ContactNetwork::shipped().expect("a network").to_bytes().expect("bytes")]
}

fn contact(input: &[u8]) -> bool {
    let Ok(network) = ContactNetwork::from_bytes(input, Path::new("fuzz")) else { return false };
    let logits = network.logits(&[0.0; INPUTS], &mut Scratch::default());
    assert!(logits.iter().all(|logit| logit.is_finite()));
    true
}

fn scenarios() -> Vec<Vec<u8>> {
    DEFAULTS.iter().map(|(_, text)| text.as_bytes().to_vec()).collect()
}

fn scenario(input: &[u8]) -> bool {
    static CONFIG: OnceLock<Config> = OnceLock::new();
    let text = String::from_utf8_lossy(input);
    // The first scenario that knows all of the parameters.
    let Some(scenario) = DEFAULTS.iter().find_map(|(name, _)| Scenario::named(name, &text).ok()) else { return false };
    // Terrains and fields of balls take milliseconds each.
    if matches!(scenario, Scenario::Terrain(_)) && !input.len().is_multiple_of(32) {
        return true;
    }
    let config = CONFIG.get_or_init(|| Config::load("compliant").expect("an embedded configuration"));
    let Ok(script) = scenario.script(input.len() as u64, config) else { return false };
    if input.len().is_multiple_of(64) && script.scene.buffers.contacts < 1000 {
        let sim = Sim::new(&script.scene, &config.simulation, config.episode.min_height_m);
        sim.expect("a scene within the ranges compiles");
    }
    true
}

fn networks() -> Vec<Vec<u8>> {
    let ours = onnx::export(&tiny_trainer("compliant").policy());
    let theirs = ["operators", "playground", "rsl_rl", "newer"].map(|name| fixture(&format!("onnx/{name}.onnx")));
    theirs.into_iter().chain([ours]).collect()
}

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(ROOT).join("tests/fixtures").join(name)).expect("a fixture")
}

fn onnx_file(input: &[u8]) -> bool {
    let Ok(network) = onnx::OnnxNetwork::from_bytes(input, Path::new("fuzz")) else { return false };
    let outputs = network.forward(&vec![0.5; network.inputs()], &mut onnx::OnnxScratch::default()).len();
    assert_eq!(outputs, network.outputs());
    true
}

/// An MJCF fixture, to be read from wherever the child is.
fn mjcf_fixture(name: &str) -> Vec<u8> {
    let text = String::from_utf8(fixture(&format!("robot/{name}"))).expect("text");
    text.replace("meshdir=\"assets\"", &format!("meshdir=\"{ROOT}/tests/fixtures/robot/assets\"")).into_bytes()
}

fn robots() -> Vec<Vec<u8>> {
    vec![mjcf_fixture("quadruped.xml"), mjcf_fixture("renamed.xml"), fixture("robot/renamed.yaml")]
}

fn robot(input: &[u8]) -> bool {
    let name = if input.trim_ascii_start().starts_with(b"<") { "r.xml" } else { "r.yaml" };
    if !Path::new("renamed.xml").exists() {
        std::fs::write("renamed.xml", mjcf_fixture("renamed.xml")).expect("a file");
    }
    std::fs::write(name, input).expect("a file");
    let Ok(robot) = Robot::load(name) else { return false };
    let fast = Config::load("fast").expect("an embedded configuration");
    if fast.fitted_to(&robot).is_ok() && input.len().is_multiple_of(16) {
        // May be refused or a fault, which are results.
        let _ = Scene::flat(robot, 1.0 / 240.0).compile().and_then(Data::new).and_then(|mut data| data.step());
    }
    true
}

fn sessions() -> Vec<Vec<u8>> {
    let mut shelf = AgentCache::default();
    let robots = ["compliant", "baseline"].map(|name| shelf.find(name, None).expect("it ships")).to_vec();
    let setup = |scene| Setup { scene, seed: 1, robots: robots.clone() };
    let inputs = [
        Input::Setup(setup(SceneKind::Flat)),
        Input::Act(Act::Command(Command::velocity(0.5, 0.0, 0.1))),
        Input::Act(Act::Push { size: [0.1, 0.3], unit: PushUnit::Momentum }),
        Input::Act(Act::Hand(Some([5.0, -10.0]))),
        Input::Act(Act::Comply { robot: 1, compliance: Some(0.02) }),
        Input::Act(Act::Reset),
        Input::Setup(setup(SceneKind::Box)),
    ];
    let mut writer = Writer::new(tempfile::tempfile().expect("a file"));
    for (tick, input) in (0..).step_by(4).zip(&inputs) {
        writer.input(tick, input, &shelf).expect("a line");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("session.jsonl");
    writer.part(None, 40, "state".to_owned()).and_then(|part| part.write_new(&path)).expect("a session");
    vec![std::fs::read(path).expect("a session")]
}

fn session(input: &[u8]) -> bool {
    std::fs::write("s.jsonl", input).expect("a file");
    let Ok(session) = SavedSession::load(Path::new("s.jsonl")) else { return false };
    if input.len().is_multiple_of(16)
        && let Ok(mut playback) = session.play()
    {
        for _ in 0..4 {
            if !matches!(playback.step(), Ok(Some(_))) {
                break;
            }
        }
    }
    true
}

fn fragments() -> Vec<Vec<u8>> {
    corpus!["mjcf/bodies.xml", "mjcf/shapes.xml", "mjcf/whole.xml", "mjcf/assets.xml"]
}

fn mjcf(input: &[u8]) -> bool {
    let text = String::from_utf8_lossy(input);
    let model = if text.starts_with("<mujoco") {
        Model::from_xml(&[("f.xml", &text)])
    } else if input.len().is_multiple_of(16) {
        let obstacles = text.into_owned();
        Scene { obstacles, ..Scene::flat(Robot::load("go1").unwrap(), 1.0 / 240.0) }.compile()
    } else {
        let size = r#"<size nconmax="50" njmax="200" nstack="20000"/>"#;
        let whole = format!("<mujoco>{size}<worldbody>{text}</worldbody></mujoco>");
        Model::from_xml(&[("f.xml", &whole)])
    };
    let Ok(model) = model else { return false };
    // Faults are results; what must not happen is the end of the process.
    let _: mujoco::Result<()> = (|| {
        let copy = model.try_clone()?;
        let mut data = Data::new(copy)?;
        data.step()?;
        data.step1()?;
        data.step2()?;
        data.reset()
    })();
    true
}
