//! Every reader of files against the inputs that fuzzing starts from and those that it found (`scripts/fuzz`).

mod targets;

use targets::TARGETS;

/// The repository.
const ROOT: &str = env!("CARGO_MANIFEST_DIR");

#[test]
fn readers_survive_the_corpus_of_fuzzing() {
    // Some targets write their input as a file.
    let folder = tempfile::tempdir().unwrap();
    std::env::set_current_dir(folder.path()).unwrap();
    for target in &TARGETS {
        let (seeds, corpus) = ((target.seeds)(), target.corpus());
        assert!(!corpus.is_empty(), "{} has no corpus", target.name);
        for (index, input) in seeds.iter().chain(&corpus).enumerate() {
            let run = std::panic::catch_unwind(|| (target.run)(input));
            assert!(run.is_ok(), "{} panics over input {index}: {:?}", target.name, String::from_utf8_lossy(input));
        }
    }
}
