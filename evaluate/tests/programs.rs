//! The program `evaluate` as a user runs it, with policies that stand still or fall.

#[path = "../../tests/it/support.rs"]
mod support;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};
use supple::config::{Config, Precision};
use supple::policy::Policy;
use supple::policy::compliance::{Point, PolicyCalibration};
use supple_evaluate::protocol::Protocol;
use support::{broken_policy, complaint, example, fails, refused, run, standing_policy, success, zero_policy};

/// The smallest protocol that runs every experiment.
const TINY: &str = "
walk: {commands: [[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]], payloads_kg: [5.0], trials: 2}
push_grid: {points_per_side: 3, trials: 2}
decay: {trials: 2}
table4: {trials: 2}
directions: {directions: 3, trials: 1}
leash: {directions: 3, trials: 1}
box: {frictions: [0.6], trials: 2}
ball_pit: {trials: 1}
terrain: {heights_m: [0.05], frequencies_per_m: [0.5], trials: 1}
pulley: {commands_m_s: [0.0], directions_deg: [90.0], trials: 1}
pendulum: {commands_m_s: [0.0], heights_m: [0.2], trials: 1}
rubble: {heights_m: [0.03], trials: 1}
outdoor: {steepest: [0.1], trials: 1}
pull: {forces_n: [20.0], directions: 3, trials: 1}
wall: {trials: 1}
lead: {commands_m_s: [0.0], directions: 3, trials: 1}
felt: {forces_n: [20.0], directions: 3, sides_deg: [90.0], heights_m: [0.1], walks: [[0.5, 0.0, 0.0]], trials: 1}
calibration: {compliances: [0.02], commands_m_s: [0.5], directions: 3, forces_n: [10.0], trials: 1}
shove: {directions: 3, trials: 1, shoves: 3}
set_point: {compliances: [0.02], directions: 3, trials: 1}
";

/// The experiments without many loose bodies, which take seconds even if nothing moves.
const CHEAP: &str = "walk push-grid decay table4 directions leash box terrain pulley pendulum outdoor pull wall lead";

/// The figures that the report must have; further experiments may add others.
const FIGURES: &str = "walk push-grid decay table4 directions directions-carried leash box box-forces ball-pit terrain \
     pulley pendulum pendulum-velocity rubble outdoor pull pull-directions wall lead";

/// A policy that folds its legs and lies down at once.
fn falling_policy() -> Policy {
    let mut config = Config::load("compliant").unwrap();
    config.action.nominal_pose_rad = supple::config::PerJoint::Alike([0.0, 1.5, -2.7]);
    zero_policy(config)
}

/// A folder with the tiny protocol and policies, in which `evaluate` runs.
struct Place(tempfile::TempDir);

impl Place {
    /// Creates a folder with policies `policies/NAME.safetensors`.
    fn new(policies: &[(&str, Policy)]) -> Self {
        let place = Place(tempfile::tempdir().unwrap());
        place.write("tiny.yaml", TINY);
        for (name, policy) in policies {
            place.save(&format!("policies/{name}"), policy);
        }
        place
    }

    /// Creates a folder with policies `compliant-seed0` and `baseline-seed0`.
    fn with_pair(compliant: Policy, baseline: Policy) -> Self {
        Place::new(&[("compliant-seed0", compliant), ("baseline-seed0", baseline)])
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    fn save(&self, name: &str, policy: &Policy) {
        self.write(&format!("{name}.safetensors"), policy.to_bytes().unwrap());
    }

    /// Runs `evaluate` with the tiny protocol.
    fn attempt(&self, arguments: &[&str]) -> Output {
        run("evaluate", self.0.path(), &[&["--protocol", "tiny.yaml"], arguments].concat())
    }

    /// Runs `evaluate`, which has to refuse its arguments with these words.
    fn refuses(&self, arguments: &[&str], expected: &str) {
        fails("evaluate", self.0.path(), &[&["--protocol", "tiny.yaml"], arguments].concat(), expected);
    }

    /// Runs `evaluate` with arguments without spaces, which has to succeed, and returns its notes.
    fn evaluate(&self, arguments: &str) -> String {
        complaint(&success(self.attempt(&arguments.split_whitespace().collect::<Vec<_>>())))
    }

    fn summary(&self, out: &str) -> Value {
        serde_json::from_str(&self.read(&format!("{out}/summary.json"))).unwrap()
    }

    /// Returns every kept measurement with the time it was written.
    fn kept(&self, out: &str) -> Vec<(PathBuf, std::time::SystemTime)> {
        let entries = |folder: &Path| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let folders = entries(&self.path(out).join("results")).filter(|entry| entry.is_dir());
        let files = folders.flat_map(|folder| entries(&folder).collect::<Vec<_>>());
        let files = files.filter(|file| file.extension().is_some_and(|extension| extension == "json"));
        let mut files: Vec<_> = files.map(|it| (it.clone(), it.metadata().unwrap().modified().unwrap())).collect();
        files.sort();
        files
    }
}

fn experiment<'a>(summary: &'a Value, name: &str) -> &'a Value {
    summary["experiments"].as_array().unwrap().iter().find(|experiment| experiment["name"] == name).unwrap()
}

/// Returns a row of a table of an experiment or of E12.
fn row<'a>(of: &'a Value, table: &str, condition: &str, quantity: &str) -> &'a Value {
    let mut rows = of["tables"][table].as_array().unwrap().iter();
    &rows.find(|row| row["condition"] == condition && row["quantity"] == quantity).unwrap()["ours"]
}

#[test]
fn examination_grades_a_policy_beside_the_references() {
    let place = Place::new(&[("mine", falling_policy())]);
    let notes = place.evaluate("--exam policies/mine.safetensors --out exam");
    let exam: Value = serde_json::from_str(&place.read("exam/exam.json")).unwrap();
    assert_eq!(exam["names"], json!(["mine", "compliant", "baseline"]));
    assert_eq!(exam["grades"].as_array().unwrap().len(), 8);
    for grade in exam["grades"].as_array().unwrap() {
        let [mine, compliant, baseline] = [0, 1, 2].map(|set| &grade["scores"][set]);
        assert_eq!((&mine["passed"], &mine["trials"]), (&Value::from(0), &compliant["trials"]), "{grade}");
        if grade["discipline"] == "compliance" {
            // It has no calibration.
            assert_eq!(mine["out_of_reach"], mine["trials"]);
        } else {
            assert_eq!(mine["falls"], mine["trials"], "{grade}");
            assert!(baseline["passed"].as_u64() > Some(0), "{grade}");
        }
    }
    let samples = |set: usize| exam["training"][set]["samples"][0].as_u64();
    assert!(samples(0) == Some(20_000_000) && samples(1) > Some(20_000_000), "{exam}");
    let page = place.read("exam/exam.html");
    assert!(page.contains("<td>20 M</td>"), "{page}");
    // The note about the policies is no fault.
    let note = "the contact network was not trained on how mine";
    assert!(notes.contains(note) && page.contains(note) && exam["notes"].to_string().contains(note), "{notes}");
    assert_eq!(exam["faults"], json!([]));
    assert!(page.contains("--exam policies/mine.safetensors --protocol tiny.yaml --out exam"), "{page}");
    assert!(place.path("exam/exam.png").metadata().unwrap().len() > 10_000);
    // A film, or a note that says why there is none; it is as wide as its six pictures.
    match std::fs::read(place.path("exam/fall.png")) {
        Ok(png) => assert_eq!((&png[16..24], page.contains("fall.png")), (&[0, 0, 7, 128, 0, 0, 0, 240][..], true)),
        Err(_) => assert!(notes.contains("no film of a fall: cannot draw a picture"), "{notes}"),
    }
}

#[test]
fn equal_evaluations_give_equal_summaries() {
    let place = Place::new(&[
        ("compliant-seed0", standing_policy()),
        ("compliant-seed1", standing_policy()),
        ("baseline-seed0", standing_policy()),
        ("baseline-seed1", falling_policy()),
    ]);
    for (out, threads) in [("one", "1"), ("two", "2")] {
        place.evaluate(&format!("{CHEAP} --out {out} --threads {threads}"));
    }
    let first = place.read("one/summary.json");
    assert!(first == place.read("two/summary.json"), "the summaries differ");

    let (summary, all) = (place.summary("one"), Protocol::quick().unwrap());
    let cheap: Vec<&str> = CHEAP.split(' ').collect();
    let names = all.experiments().into_iter().map(|experiment| experiment.info().name);
    assert_eq!(summary["not_run"], json!(names.filter(|name| !cheap.contains(name)).collect::<Vec<_>>()));
    // Seed 0 is the same policy in both sets: paired trials are equal.
    let decay = &row(experiment(&summary, "decay"), "decay", "0.5 m/s to the left", "decay_10_s")["sets"];
    assert!(decay["compliant"]["by_seed"]["0"].is_number());
    assert_eq!(decay["compliant"]["by_seed"]["0"], decay["baseline"]["by_seed"]["0"]);
    assert_eq!(decay["baseline"]["by_seed"]["1"], Value::Null, "a fall has no decay time");
    assert_eq!(experiment(&summary, "decay")["trials"]["baseline"]["falls"], 4);

    // Finished measurements are kept; `--again` repeats them.
    let before = place.kept("one");
    // Seed 0 of both sets is the same policy, which is measured once.
    assert_eq!(before.len(), cheap.len() * 3);
    place.evaluate(&format!("{CHEAP} --out one"));
    assert!(place.kept("one") == before && place.read("one/summary.json") == first);
    place.evaluate("walk --out one --again");
    assert!(place.read("one/summary.json") == first);
    assert_eq!(place.kept("one").iter().zip(&before).filter(|(a, b)| a != b).count(), 3);

    // A damaged measurement is repeated.
    let (damaged, _) = &before[0];
    let whole = std::fs::read(damaged).unwrap();
    std::fs::write(damaged, &whole[..whole.len() / 2]).unwrap();
    place.evaluate(&format!("{CHEAP} --out one"));
    assert!(place.read("one/summary.json") == first);
}

#[test]
fn two_processes_share_a_folder_without_repeating_work() {
    let place = Place::with_pair(standing_policy(), falling_policy());
    let spawn = |experiments: &[&str]| {
        let mut command = Command::new(support::program("evaluate"));
        command.args(["--protocol", "tiny.yaml", "--out", "shared"]).args(experiments).current_dir(place.path(""));
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    // The process that ends last reports everything.
    place.evaluate("walk decay leash box --out alone");
    let mut both = [spawn(&["walk", "box"]), spawn(&["decay", "leash"])];
    assert!(both.iter_mut().all(|process| process.wait().unwrap().success()));
    assert!(place.summary("shared") == place.summary("alone"));

    // A process waits for another one that measures the same experiment, and reads its results.
    let [measured, shared] = ["alone", "shared"].map(|out| place.path(out).join("results/walk"));
    std::fs::remove_dir_all(&shared).unwrap();
    std::fs::create_dir(&shared).unwrap();
    let lock = std::fs::File::create(shared.join(".lock")).unwrap();
    lock.lock().unwrap();
    std::fs::write(shared.join(".lock"), "process 7 on elsewhere").unwrap();
    let waiting = spawn(&["walk"]);
    let is_waiting =
        |text: String| text.lines().any(|line| line.contains("->") && line.contains(&format!(" {} ", waiting.id())));
    while !is_waiting(std::fs::read_to_string("/proc/locks").unwrap()) {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    for (file, _) in place.kept("alone").iter().filter(|(file, _)| file.starts_with(&measured)) {
        std::fs::copy(file, shared.join(file.file_name().unwrap())).unwrap();
    }
    let before = place.kept("shared");
    drop(lock);
    let output = waiting.wait_with_output().unwrap();
    assert!(output.status.success() && place.kept("shared") == before);
    assert!(complaint(&output).contains("waiting for process 7 on elsewhere, which measures walk"));
    assert!(place.summary("shared") == place.summary("alone"));
}

#[test]
fn slurm_recipe_has_a_task_for_every_experiment() {
    let recipe = std::fs::read_to_string(support::repository("examples/slurm/evaluate.sbatch")).unwrap();
    let (_, names) = recipe.split_once("experiments=(").unwrap();
    let names: Vec<&str> = names.split_once(')').unwrap().0.split_whitespace().collect();
    let protocol = Protocol::full().unwrap();
    assert_eq!(names, protocol.experiments().iter().map(|experiment| experiment.info().name).collect::<Vec<_>>());
    assert!(recipe.contains(&format!("--array=0-{}\n", names.len() - 1)));
}

#[test]
fn report_page_opens_in_a_browser() {
    let place = Place::new(&[("standing", standing_policy()), ("falling", falling_policy())]);
    place.evaluate(
        "--a policies/standing.safetensors --b policies/falling.safetensors --names standing,falling --out report \
         --results results.md",
    );

    let summary = place.summary("report");
    let notes = |name: &str| experiment(&summary, name)["notes"].to_string();
    let of_all = summary["notes"].to_string();
    assert!(of_all.contains("standing, seed 0, does not follow its command: its velocity error is 0.50 m/s"));
    assert!(of_all.contains("falling, seed 0, falls without any disturbance"), "{of_all}");
    assert!(notes("box").contains("falling fell in every trial"));
    for (name, condition, quantity, set, expected) in [
        ("ball-pit", "", "stuck", "standing", json!(100.0)),
        ("ball-pit", "", "fell", "falling", json!(100.0)),
        ("ball-pit", "", "peak_foot_force_n", "falling", Value::Null),
        ("box", "friction 0.6", "box_displacement_m", "falling", Value::Null),
        // A box that was not met has no displacement.
        ("box", "friction 0.6", "box_displacement_m", "standing", Value::Null),
    ] {
        let found = row(experiment(&summary, name), name, condition, quantity);
        assert_eq!(found["sets"][set]["mean"], expected, "{name}: {quantity} of {set}");
    }
    let claims = experiment(&summary, "decay")["claims"].to_string();
    assert!(claims.contains("\"verdict\":\"undefined\""), "{claims}");

    let entries = std::fs::read_dir(place.path("report/figures")).unwrap().map(|entry| entry.unwrap().path());
    let drawn: BTreeSet<String> = entries.map(|it| it.file_stem().unwrap().to_string_lossy().into_owned()).collect();
    let experiments = summary["experiments"].as_array().unwrap().iter();
    let names: Vec<&str> = experiments.map(|experiment| experiment["name"].as_str().unwrap()).collect();
    for name in &names {
        assert!(drawn.iter().any(|figure| figure.starts_with(name)), "{name} has no figure");
    }
    for figure in FIGURES.split_whitespace() {
        assert!(drawn.contains(figure), "{figure} is missing");
    }
    for figure in &drawn {
        assert!(names.iter().any(|name| figure.starts_with(name)), "{figure}");
        let svg = place.read(&format!("report/figures/{figure}.svg"));
        assert!(svg.starts_with("<svg") && !svg.contains("NaN"), "{figure}");
        let png = std::fs::read(place.path(&format!("report/figures/{figure}.png"))).unwrap();
        assert!(png.starts_with(b"\x89PNG") && png.len() > 5000, "{figure}");
    }
    assert!(place.path("report/tables/claims.csv").exists());
    for table in ["walk", "push-grid-points", "table4", "leash-all", "terrain"] {
        assert!(["csv", "md"].iter().all(|kind| place.path(&format!("report/tables/{table}.{kind}")).exists()));
    }
    // The points of figures' lines are in files.
    let points = place.read("report/tables/decay-curves.csv");
    let [head, first] = points.lines().take(2).collect::<Vec<_>>()[..] else { panic!("{points}") };
    assert_eq!(head, "line,time_s,mean_m_s,least_m_s,largest_m_s");
    assert!(first.starts_with("\"0.5 m/s to the left: standing, seed 0, 2 runs\",-0.98"), "{first}");
    let paths = experiment(&summary, "box")["lines"][0]["lines"].as_array().unwrap();
    assert!(paths[0]["label"] == "standing, seed 0, trial 0" && paths[0]["rows"].as_array().unwrap().len() > 100);
    let page = place.read("report/report.html");
    let sha256 = summary["policies"][0]["sha256"].as_str().unwrap();
    for words in [sha256, "Definitions", "Time for all trials", "Measured by revision", "<dd>6 × 1 × 2</dd>"] {
        assert!(page.contains(words), "{words}");
    }
    let document = place.read("results.md");
    for words in ["measured by revision", "--results results.md", "## E1 Push recovery (Fig. 2)"] {
        assert!(document.contains(words), "{document}");
    }
    for figure in ["decay", "push-grid"] {
        assert!(document.contains(&format!("](images/{figure}.png)")), "{document}");
        let [image, drawn] =
            ["images", "report/figures"].map(|at| std::fs::read(place.path(&format!("{at}/{figure}.png"))));
        assert_eq!(image.unwrap(), drawn.unwrap());
    }
    check_page(&place.path("report/report.html"), &drawn);
}

/// Checks the page in headless Chromium: no figure is cut off, nothing is fetched, and the console is silent.
fn check_page(page: &Path, drawn: &BTreeSet<String>) {
    let text = std::fs::read_to_string(page).unwrap();
    let others = text.replace("http://www.w3.org/2000/svg", "");
    assert!(!others.contains("http"), "the page refers to something outside it");
    let frame = page.with_file_name("frame.html");
    std::fs::write(&frame, include_str!("frame.html").replace("PAGE", &format!("file://{}", page.display()))).unwrap();
    let Some((dom, console)) = browse(&frame) else {
        eprintln!("SKIPPED: the page was not opened, because /usr/bin/chromium is missing (Debian package chromium)");
        return;
    };
    assert!(!console.contains("CONSOLE"), "{console}");
    let found = dom.split_once("<pre id=\"found\">").unwrap().1.split_once("</pre>").unwrap().0;
    let found: Value = serde_json::from_str(found).unwrap_or_else(|_| panic!("{found}"));
    assert!(found["narrow"].as_u64().unwrap() <= 390, "the page is {} px wide on a phone", found["narrow"]);
    let figures = found["figures"].as_array().unwrap();
    let names = figures.iter().map(|figure| figure["name"].as_str().unwrap().to_owned());
    assert_eq!(&names.collect::<BTreeSet<_>>(), drawn);
    for figure in figures {
        assert_eq!(figure["cut"], json!([]), "text outside of the drawing: {figure}");
        let [width, height, right] = ["width", "height", "right"].map(|key| figure[key].as_f64().unwrap());
        assert!(width > 300.0 && height > 100.0 && right <= found["width"].as_f64().unwrap() + 1.0, "{figure}");
    }
    // The check detects a page with a script error.
    let broken = page.with_file_name("broken.html");
    std::fs::write(&broken, text.replace("</body>", "<script>nowhere();</script></body>")).unwrap();
    let (_, console) = browse(&broken).unwrap();
    assert!(console.contains("nowhere is not defined"), "{console}");
}

/// Returns the document as Chromium parses it, and its log; none if Chromium is not installed.
fn browse(page: &Path) -> Option<(String, String)> {
    let chromium = Path::new("/usr/bin/chromium");
    if !chromium.exists() {
        return None;
    }
    let profile = tempfile::tempdir().unwrap();
    let output = Command::new(chromium)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--dump-dom"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--allow-file-access-from-files", "--enable-logging=stderr", "--virtual-time-budget=10000"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("file://{}", page.display()))
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Some((text(&output.stdout), text(&output.stderr)))
}

#[test]
fn estimated_sensing_is_reported_beside_the_true_state() {
    let place = Place::with_pair(standing_policy(), falling_policy());
    place.evaluate("walk leash --out report");
    let plain = place.summary("report");
    assert_eq!(plain.get("sensing"), None);
    assert!(!place.path("report/tables/sensing.csv").exists());

    place.evaluate("walk --sensing estimated --out report --results results.md");
    let both = place.summary("report");
    assert_eq!(both["experiments"], plain["experiments"]);
    let sensing = &both["sensing"];
    assert_eq!(sensing["experiments"], json!(["walk"]));
    let power = row(sensing, "sensing-all", "E0 walk, standing, compliant", "power_w");
    let [estimated, truth] = ["estimated", "true state"].map(|way| power["sets"][way]["mean"].as_f64().unwrap());
    assert_eq!(estimated, truth, "estimates do not change a policy that ignores its observation");
    let plain_power = row(experiment(&plain, "walk"), "walk-commands", "standing", "power_w");
    assert_eq!(truth, plain_power["sets"]["compliant"]["mean"]);
    let falls = row(sensing, "sensing-all", "E0 walk, standing, baseline", "fell");
    assert_eq!(falls["sets"]["estimated"]["mean"], 100.0);
    let velocity = row(sensing, "sensing-errors", "E0 walk", "estimate_velocity_rmse_m_s");
    assert!(velocity["sets"]["compliant"]["mean"].as_f64().unwrap() < 0.05, "{velocity}");
    for name in ["sensing", "sensing-all", "sensing-errors"] {
        assert!(place.path(&format!("report/tables/{name}.csv")).exists(), "{name}");
    }
    let page = place.read("report/report.html");
    assert!(page.contains("E12 Acting on sensors") && page.contains("<th>true state</th>"));
    let document = place.read("results.md");
    assert!(document.contains("## E12: acting on sensors"), "{document}");
    assert!(!place.path("images").exists(), "neither of the document's figures was asked for");

    // The section stays in the report, and its experiments are not repeated.
    let before = place.kept("report");
    place.evaluate("leash --out report");
    assert!(place.kept("report") == before);
    assert_eq!(place.summary("report")["sensing"], *sensing);
}

#[test]
fn missing_seed_is_left_out_of_differences_only() {
    let mut config = Config::load("compliant").unwrap();
    config.episode.recovery_stage = false;
    config.ppo.epochs = 7;
    // Which arithmetic computed the same numbers is no difference.
    config.ppo.precision = Precision::Mixed;
    let mut baseline = zero_policy(config);
    baseline.provenance.samples = 60_006_400;
    let place = Place::new(&[
        ("compliant-seed0", standing_policy()),
        ("compliant-seed3", standing_policy()),
        ("baseline-seed0", baseline),
        ("other", standing_policy()),
    ]);
    let printed = place.evaluate("walk --out report");
    assert!(printed.contains("baseline has no policy of seed 3"), "{printed}");
    let summary = place.summary("report");
    let notes = summary["notes"].to_string();
    for words in [
        "no policy of seed 3",
        "other.safetensors was left out",
        "not trained alike",
        "configurations differ in ppo.epochs\"",
        "compliant, seeds 0 and 3, are one policy",
        "compliant, seed 3, was trained with seed 0",
    ] {
        assert!(notes.contains(words), "{words}: {notes}");
    }
    let samples = "compliant has 20 million samples, baseline 60 million: differences may come from that";
    assert_eq!((&summary["notes"][0], &summary["training"][1]["samples"][0]), (&samples.into(), &60_006_400.into()));
    assert_eq!(summary["differing_keys"], json!(["ppo.epochs"]));
    let power = row(experiment(&summary, "walk"), "walk", "forward 0.5", "power_w");
    assert_eq!(power["sets"]["compliant"]["by_seed"].as_object().unwrap().len(), 2);
    assert_eq!(power["difference"], json!({"value": 0.0, "interval": null, "pairs": 1}));
    let page = place.read("report/report.html");
    assert!(page.contains("no policy of seed 3") && page.contains("<td>60 M</td>"), "{page}");

    // With another set in the same folder, figures of experiments that it has not run are removed.
    let figure = place.path("report/figures/walk.png");
    assert!(figure.exists());
    place.save("policies/compliant-seed0", &falling_policy());
    place.evaluate("table4 --out report");
    assert!(!figure.exists());
    let command = "evaluate -- walk --policies policies --protocol tiny.yaml --out report";
    assert!(place.read("report/report.html").contains(command), "the page has the commands of missing experiments");
}

#[test]
fn shipped_policies_are_compared_without_a_folder() {
    let place = Place::new(&[]);
    place.evaluate("walk --out report");
    assert_eq!(place.summary("report")["policies"].as_array().unwrap().len(), 10);
    // The command that makes the report again.
    let page = place.read("report/report.html");
    assert!(page.contains(" --protocol tiny.yaml --out report") && !page.contains("--policies"));
}

#[test]
fn third_set_leaves_the_compared_two_unchanged() {
    let place = Place::with_pair(standing_policy(), standing_policy());
    place.save("fallen/policy-seed0", &falling_policy());
    let experiments = "walk push-grid decay leash box";
    place.evaluate(&format!("{experiments} --out two"));
    let also = "--also lying=fallen --also more=fallen/policy-seed0.safetensors";
    place.evaluate(&format!("{experiments} {also} --out four --results results.md"));

    let (two, four) = (place.summary("two"), place.summary("four"));
    assert_eq!(four["sets"], json!(["compliant", "baseline", "lying", "more"]));
    assert_eq!(four["policies"].as_array().unwrap().len(), 4);
    let falls = |summary: &Value| row(experiment(summary, "walk"), "walk", "forward 0.5", "fell").clone();
    assert_eq!(falls(&four)["sets"]["lying"]["mean"], 100.0);
    for set in ["compliant", "baseline"] {
        assert_eq!(falls(&four)["sets"][set], falls(&two)["sets"][set]);
    }
    let verdicts = |summary: &Value| {
        let claims = experiment(summary, "decay")["claims"].as_array().unwrap().iter();
        claims.map(|claim| (claim["verdict"].clone(), claim["ours"]["difference"].clone())).collect::<Vec<_>>()
    };
    assert_eq!(verdicts(&four), verdicts(&two));
    let head = place.read("four/tables/walk.csv");
    assert!(head.contains(",baseline_seeds,lying_mean,lying_sd,lying_seeds,more_mean,"), "{head}");
    for figure in experiments.split(' ') {
        let svg = place.read(&format!("four/figures/{figure}.svg"));
        assert!(svg.contains("lying") && svg.contains("more") && !svg.contains("NaN"), "{figure}");
    }
    let page = place.read("four/report.html");
    assert!(page.contains("compliant against baseline and lying and more") && page.contains("<th>lying</th>"));
    let document = place.read("results.md");
    for words in ["falls, more", "difference [95 % interval], compliant and baseline"] {
        assert!(document.contains(words), "{document}");
    }

    for (also, expected) in [
        ("lying", "expected NAME=PATH"),
        ("baseline=fallen", "--also baseline: another set has this name"),
        ("lying=nowhere", "there is no policy 'nowhere'"),
    ] {
        place.refuses(&["walk", "--also", also], expected);
    }
}

#[test]
fn set_with_commanded_compliance_is_measured_apart() {
    let place = Place::with_pair(standing_policy(), falling_policy());
    place.save("policies/baseline-seed1", &falling_policy());
    let calibrate = |own: f64| {
        let points = [0.01, 0.05].map(|c| Point { commanded: c, measured: [c; 2] }).to_vec();
        let (sha256, own_m_s_per_n) = (standing_policy().sha256().to_owned(), [own; 2]);
        let calibration = PolicyCalibration { sha256, mass_kg: 12.0, own_m_s_per_n, tracking: [1.0; 2], points };
        place.write("policies/compliant-seed0.calibration.json", serde_json::to_string(&calibration).unwrap());
    };
    calibrate(0.02);
    let soft = "leash --also soft=policies/compliant@0.03 --out report";
    place.evaluate(soft);
    let found = place.summary("report");
    let notes = found["notes"].to_string();
    assert!(notes.contains("soft has a commanded compliance of 0.03 m/s/N") && !notes.contains("left out"), "{notes}");
    // A policy that ignores its observation does not yield.
    let offset = &row(experiment(&found, "leash"), "leash", "20 N", "offset_m_s")["sets"];
    assert_eq!(offset["soft"]["by_seed"], offset["compliant"]["by_seed"]);
    // The policy with and without commanded compliance has separate measurements.
    let before = place.kept("report");
    assert_eq!(before.len(), 4);
    place.evaluate(soft);
    assert!(place.kept("report") == before);
    // A new calibration makes the measurement stale where compliance is commanded.
    calibrate(0.021);
    place.evaluate(soft);
    assert_eq!(place.kept("report").len(), 5);

    for (path, expected) in [
        ("policies/compliant@0.06", "policies/compliant-seed0.safetensors: compliance 0.06 m/s/N is out of range"),
        ("policies/baseline@0.03", "policies/baseline-seed0.safetensors: its compliance has not been measured"),
        ("policies/absent@0.03", "there is no policy 'policies/absent'"),
    ] {
        for sets in [&["--also", &format!("soft={path}")][..], &["--a", path, "--b", "policies/baseline"]] {
            place.refuses(&[&["leash", "--out", "x"], sets].concat(), expected);
            assert!(!place.path("x").exists());
        }
    }
}

#[test]
fn evaluate_compares_an_external_policy_with_ours() {
    let place = Place::new(&[]);
    example(&place.path(""), "rsl_rl");
    place.save("b", &standing_policy());
    place.write("tiny.yaml", "walk: {commands: [[0.0, 0.0, 0.0]]}\n");
    place.evaluate("walk --a rsl_rl.yaml --b b.safetensors");
    let summary = place.summary("report");
    assert_eq!(summary["policies"][0]["config"], "external", "{summary}");
    assert_eq!(summary["policies"][0]["samples"], Value::Null);
}

#[test]
fn invalid_arguments_exit_with_code_2() {
    let place = Place::with_pair(standing_policy(), standing_policy());
    std::fs::create_dir(place.path("empty")).unwrap();
    let mut poisoned = standing_policy();
    poisoned.actor.layers[0].weight[0] = f32::NAN;
    place.save("nan/compliant-seed0", &poisoned);
    for name in ["lone/compliant-seed0", "nan/baseline-seed0", "twice/a-seed1", "twice/b-seed1"] {
        place.save(name, &standing_policy());
    }
    let cases: [(&[&str], &str); 9] = [
        (&["--policies", "nowhere"], "cannot read the policies in nowhere"),
        (&["--policies", "empty"], "empty has no policy compliant-seedN.safetensors"),
        (&["--policies", "lone"], "lone has no policy baseline-seedN.safetensors"),
        (
            &["--policies", "nan"],
            "nan/compliant-seed0.safetensors: its tensor policy.0.weight holds numbers that are not finite",
        ),
        (&["--a", "twice", "--b", "lone"], "are both seed 1 of twice"),
        (&["--a", "lone/x", "--b", "twice/x"], "expected two different names: give --names A,B"),
        (&["--a", "empty", "--b", "lone"], "empty has no policy *.safetensors"),
        (&["--names", "one"], "--names gives 1 names, expected two: A,B"),
        (&["--protocol", "nowhere.yaml"], "cannot read protocol nowhere.yaml"),
    ];
    for (arguments, expected) in cases {
        refused("evaluate", &place.path(""), &[arguments, &["--out", "x"]].concat(), expected);
        assert!(!place.path("x").exists(), "{arguments:?} left a folder");
    }
}

#[test]
fn faults_are_named_and_end_with_two() {
    let place = Place::new(&[("standing", standing_policy())]);
    broken_policy(&place.path(""));
    let sets = ["--a", "broken.yaml", "--b", "policies/standing.safetensors", "--names", "mine,ours"];
    let output = place.attempt(&[&["walk", "--out", "report"], &sets[..]].concat());
    let words = complaint(&output);
    assert_eq!(output.status.code(), Some(2), "{words}");
    // Two trials of two commands and of one payload.
    assert!(words.contains("experiment walk: 6 of 6 trials of mine ended in a fault"), "{words}");
    assert!(words.contains("FR_hip is NaN"), "{words}");
    // A line for each policy, with what is left.
    let lines: Vec<&str> = words.lines().filter(|line| line.starts_with("E0 walk, ")).collect();
    assert!(lines[0].starts_with("E0 walk, mine: 6 trials in ") && lines[0].contains("; 6 trials left, "), "{words}");
    assert!(lines[1].starts_with("E0 walk, ours: 6 trials in ") && !lines[1].contains("left"), "{words}");
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("Walking") && table.contains("does not hold for"), "{table}");
    assert!(table.lines().all(|line| line.chars().count() <= 80), "{table}");
    let summary = place.summary("report");
    let trials = &experiment(&summary, "walk")["trials"];
    assert_eq!((&trials["mine"]["faults"], &trials["ours"]["faults"]), (&6.into(), &0.into()));
    assert!(place.read("report/report.html").contains("FR_hip is NaN"));
}

#[test]
fn names_and_labels_are_checked_before_measuring() {
    let place = Place::with_pair(standing_policy(), standing_policy());
    let long = "n".repeat(41);
    let pair = ["--a", "policies/compliant-seed0.safetensors", "--b", "policies/baseline-seed0.safetensors"];
    for name in ["a\u{7}", "a\nb", &long] {
        let names = ["walk", "--out", "r", "--names", &format!("{name},b")];
        place.refuses(&[&names, &pair[..]].concat(), "--names: the name");
        let also = format!("{name}=policies/baseline-seed0.safetensors");
        place.refuses(&["walk", "--out", "r", "--also", &also], "--also: the name");
    }
    for results in [".", "nowhere/x.md"] {
        place.refuses(&["walk", "--out", "r", "--results", results], &format!("--results {results}: "));
    }
    assert!(!place.path("r").exists());
    // A label with all its zeros would be longer than its figure is wide.
    place.write("tiny.yaml", "wall: {commands_m_s: [1.0e-300], trials: 1}");
    place.evaluate("wall --out r");
    assert!(place.read("r/figures/wall.svg").contains("1e-300 m/s"));
}

#[test]
fn first_study_of_the_manual_plays_in_miniature() {
    let page = include_str!("../../docs/first-study.md");
    let (_, rest) = page.split_once("```yaml\n").unwrap();
    let place = Place::new(&[]);
    place.write("variants.yaml", rest.split_once("```").unwrap().0);
    let commands = page.lines().filter_map(|line| line.strip_prefix("cargo run --release --bin "));
    let mut printed = String::new();
    for command in commands.clone() {
        let (name, arguments) = command.split_once(" -- ").unwrap();
        let small = arguments.replace("--samples 3000000", "--samples 8192").replace("--quick", "--protocol tiny.yaml");
        // Cargo builds the programs of a workspace into one folder.
        let program = Path::new(env!("CARGO_BIN_EXE_evaluate")).with_file_name(name);
        assert!(program.is_file(), "build {} first: cargo build --workspace", program.display());
        let output = Command::new(program).current_dir(place.path("")).args(small.split(' ')).output().unwrap();
        assert!(output.status.success(), "{command}: {}", complaint(&output));
        printed.push_str(&String::from_utf8(output.stdout).unwrap());
    }
    assert_eq!(commands.count(), 4);
    assert!(place.path("curves/learning-samples.png").is_file());
    assert!(place.path("study/report.html").is_file() && printed.contains("fast-thrifty"), "{printed}");
    let summary = place.summary("study");
    let policies = |set: &str| summary["policies"].as_array().unwrap().iter().filter(|it| it["set"] == set).count();
    assert_eq!((policies("fast-thrifty"), policies("fast-plain")), (3, 3));
    assert!(summary["differing_keys"].to_string().contains("reward.energy"), "{}", summary["differing_keys"]);
}
