//! What is fuzzed: corpus, words and the function under test.

use std::path::Path;
use std::sync::OnceLock;

use clap::{FromArgMatches, Subcommand};
use rand_chacha::ChaCha8Rng;
use supple::config::Config;
use supple::estimate::contact::{ContactNetwork, INPUTS};
use supple::mujoco::{self, Data, Model};
use supple::network::Scratch;
use supple::policy::Policy;
use supple::policy::onnx;
use supple::robot::Robot;
use supple::scenario::catalog::{DEFAULTS, Scenario};
use supple::scenario::session::{AgentCache, Input, PushUnit, SavedSession, SceneKind, Setup, Writer};
use supple::sim::Scene;
use supple::sim::Sim;
use supple::task::Command;
use supple::train::Trainer;
use supple::train::checkpoint::{Checkpoint, RunState};
use supple::util::yaml::{Text, flat_parameters};

use crate::ROOT;
use crate::mutate::mutate;

/// A reader of files.
pub struct Target {
    /// The name on the command line.
    pub name: &'static str,
    corpus: fn() -> Vec<Vec<u8>>,
    cache: OnceLock<Vec<Vec<u8>>>,
    /// The words that such files consist of.
    pub words: &'static [&'static str],
    /// True if inputs are safetensors files, some of which are mutated in their header only.
    pub framed: bool,
    /// Whether the input was accepted. Must not panic, abort, hang or take much memory.
    pub run: fn(&[u8]) -> bool,
}

impl Target {
    /// Returns the valid inputs that mutations start from.
    pub fn seeds(&self) -> &[Vec<u8>] {
        self.cache.get_or_init(self.corpus)
    }

    /// An input changed somewhere, or within the header that it has.
    pub fn mutated(&self, whole: &[u8], in_header: bool, rng: &mut ChaCha8Rng) -> Vec<u8> {
        match header(whole).filter(|_| self.framed && in_header) {
            Some((header, tensors)) => {
                let header = mutate(&[header.to_vec()], self.words, rng);
                [&(header.len() as u64).to_le_bytes()[..], &header, tensors].concat()
            }
            None => mutate(&[whole.to_vec()], self.words, rng),
        }
    }
}

/// Header and tensors of a safetensors file.
fn header(file: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = file.split_first_chunk::<8>()?;
    rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)
}

const YAML_WORDS: &[&str] = &[
    ": ",
    "\n",
    "\n  ",
    "- ",
    "[",
    "]",
    "{",
    "}",
    "&a ",
    "*a",
    "<<: *a",
    "!!binary ",
    "!x ",
    "null",
    "~",
    "true",
    "|\n",
    "\"",
    "'",
    "#",
    "---\n",
    "...\n",
    "? ",
    "base: compliant\n",
    "base: ",
    "\t",
    "%YAML 1.1\n",
    "ppo:\n",
    "perlin",
    "steps",
];
const JSON_WORDS: &[&str] = &[
    "{", "}", "[", "]", "\"", "\\\"", ":", ",", "null", "true", "[]", "{}", "\\u0000", "F16", "F64", "format", "[0,0]",
];
const XML_WORDS: &[&str] = &[
    "<body>",
    "</body>",
    "<geom type=\"box\" size=\"1 1 1\"/>",
    "<geom type=\"mesh\" mesh=\"m\"/>",
    "<freejoint/>",
    "<joint type=\"ball\"/>",
    "<joint/>",
    "type=\"hfield\"",
    "type=\"capsule\"",
    "type=\"ellipsoid\"",
    "fromto=\"0 0 0 1 1 1\"",
    "euler=\"1 2 3\"",
    "quat=\"0 0 0 0\"",
    "mass=\"0\"",
    "<inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1 1 9\"/>",
    "name=\"\"",
    "class=\"x\"",
    "childclass=\"main\"",
    "<site/>",
    "<camera/>",
    "<light/>",
    "<include file=\"f.xml\"/>",
    "<!--",
    "-->",
    "&amp;",
    "<![CDATA[",
    "<composite type=\"grid\" count=\"3 3 1\" spacing=\"0.1\"/>",
    "<replicate/>",
    "mocap=\"true\"",
    "<?xml?>",
    "range=\"1 -1\"",
    "limited=\"true\"",
    "damping=\"1\"",
    "armature=\"1\"",
    "condim=\"6\"",
    "solref=\"0 0\"",
    "margin=\"1\"",
    "/>",
    "\"",
    "=",
];

const ONNX_WORDS: &[&str] = &[
    "Gemm",
    "MatMul",
    "Add",
    "Elu",
    "Tanh",
    "Relu",
    "Reshape",
    "Concat",
    "Slice",
    "Gather",
    "Split",
    "Shape",
    "Cast",
    "axis",
    "transB",
    "alpha",
    "obs",
    "actions",
    "\u{1}",
    "\u{7f}",
    "\u{0}\u{0}",
];
const ROBOT_WORDS: &[&str] = &[
    "<body>",
    "</body>",
    "<geom type=\"sphere\" size=\"0.02\"/>",
    "<joint axis=\"0 1 0\"/>",
    "<freejoint/>",
    "type=\"slide\"",
    "type=\"ball\"",
    "name=\"FR_foot\"",
    "<motor joint=\"FR_hip\"/>",
    "<position joint=\"FR_hip\" kp=\"1\"/>",
    "<default class=\"x\"/>",
    "class=\"x\"",
    "<key name=\"home\" qpos=\"0 0 1\"/>",
    "<tendon><fixed/></tendon>",
    "<include file=\"r.xml\"/>",
    "angle=\"degree\"",
    "autolimits=\"true\"",
    "range=\"1 -1\"",
    "mjcf: r.xml\n",
    "feet:\n",
    "joints:\n",
    "nominal_pose_rad: [0, 0, 0]\n",
    "torque_limits_n_m: [1, 1, 1]\n",
    "[",
    "]",
    "null",
];

/// All of them.
pub static TARGETS: [Target; 9] = [
    Target { name: "config", corpus: configs, cache: OnceLock::new(), words: YAML_WORDS, framed: false, run: config },
    Target {
        name: "checkpoint",
        corpus: checkpoints,
        cache: OnceLock::new(),
        words: JSON_WORDS,
        framed: true,
        run: checkpoint,
    },
    Target { name: "policy", corpus: policies, cache: OnceLock::new(), words: JSON_WORDS, framed: true, run: policy },
    Target { name: "contact", corpus: contacts, cache: OnceLock::new(), words: JSON_WORDS, framed: true, run: contact },
    Target {
        name: "scenario",
        corpus: scenarios,
        cache: OnceLock::new(),
        words: YAML_WORDS,
        framed: false,
        run: scenario,
    },
    Target { name: "onnx", corpus: networks, cache: OnceLock::new(), words: ONNX_WORDS, framed: false, run: onnx_file },
    Target { name: "robot", corpus: robots, cache: OnceLock::new(), words: ROBOT_WORDS, framed: false, run: robot },
    Target {
        name: "session",
        corpus: sessions,
        cache: OnceLock::new(),
        words: JSON_WORDS,
        framed: false,
        run: session,
    },
    Target { name: "mjcf", corpus: fragments, cache: OnceLock::new(), words: XML_WORDS, framed: false, run: mjcf },
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

fn tiny_trainer() -> Trainer {
    let mut config = Config::load("compliant").expect("an embedded configuration");
    config.ppo.environments = 1;
    config.ppo.batch_size = 4;
    config.ppo.minibatch_size = 2;
    config.ppo.epochs = 1;
    config.ppo.hidden_layers = vec![2];
    Trainer::new("fuzz", config, 0, 1).expect("a trainer")
}

fn tiny_checkpoint() -> &'static Checkpoint {
    static MADE: OnceLock<Checkpoint> = OnceLock::new();
    MADE.get_or_init(|| {
        let mut trainer = tiny_trainer();
        trainer.iterate().expect("an iteration");
        let mut checkpoint = trainer.checkpoint().expect("a checkpoint");
        // Else the input of a number would not be the same the next time.
        checkpoint.run.elapsed_s = 1.5;
        checkpoint
    })
}

/// A file, and the part of it that its checksum guards, to be sealed again after a mutation.
fn checkpoints() -> Vec<Vec<u8>> {
    let checkpoint = tiny_checkpoint();
    vec![checkpoint.to_bytes().expect("bytes"), serde_json::to_vec(&checkpoint.run).expect("JSON")]
}

fn checkpoint(input: &[u8]) -> bool {
    let Ok(run) = serde_json::from_slice::<RunState>(input) else {
        return Checkpoint::from_bytes(input).is_ok();
    };
    let learner = tiny_checkpoint().learner.clone();
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
    vec![tiny_trainer().policy().to_bytes().expect("bytes")]
}

fn policy(input: &[u8]) -> bool {
    let Ok(policy) = Policy::from_bytes(input, Path::new("fuzz")) else { return false };
    assert!(!policy.metadata_json().is_empty() && !onnx::export(&policy).is_empty());
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
    let Ok(given) = flat_parameters(&Text::new("fuzz", &text)) else { return false };
    // The scenario that knows all of the parameters, as a user would choose it.
    let known =
        DEFAULTS.iter().map(|(name, text)| (name, flat_parameters(&Text::new(name, text)).expect("the defaults")));
    let Some((name, defaults)) = known
        .into_iter()
        .find(|(_, defaults)| given.iter().all(|(key, _)| defaults.iter().any(|(known, _)| known == key)))
    else {
        return false;
    };
    let mut line = vec!["scenario".to_owned(), (*name).to_owned()];
    for (key, default) in defaults {
        let value = given.iter().find(|(given, _)| *given == key).map_or(&default, |(_, value)| value);
        line.push(format!("--{}={value}", key.replace('_', "-")));
    }
    let command = Scenario::augment_subcommands(clap::Command::new("scenario"));
    let Ok(matches) = command.try_get_matches_from(line) else { return false };
    let Ok(scenario) = Scenario::from_arg_matches(&matches) else { return false };
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
    let ours = onnx::export(&tiny_trainer().policy());
    let theirs = ["operators", "playground", "rsl_rl"].map(|name| fixture(&format!("onnx/{name}.onnx")));
    theirs.into_iter().chain([ours]).collect()
}

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(ROOT).join("tests/fixtures").join(name)).expect("a fixture")
}

fn onnx_file(input: &[u8]) -> bool {
    let Ok(network) = onnx::Network::from_bytes(input, Path::new("fuzz")) else { return false };
    let outputs = network.forward(&vec![0.5; network.inputs()], &mut onnx::Scratch::default()).len();
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
        Input::Command(Command::velocity(0.5, 0.0, 0.1)),
        Input::Push { size: [0.1, 0.3], unit: PushUnit::Momentum },
        Input::Pull(Some([5.0, -10.0])),
        Input::Comply { robot: 1, compliance: Some(0.02) },
        Input::Reset,
        Input::Setup(setup(SceneKind::Box)),
    ];
    let mut writer = Writer::new(tempfile::tempfile().expect("a file"));
    for (tick, input) in (0..).step_by(4).zip(&inputs) {
        writer.input(tick, input, &shelf).expect("a line");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("session.jsonl");
    writer.keep(&path, None, 40, "state".to_owned()).expect("a session");
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
