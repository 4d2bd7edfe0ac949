/*! Fuzzing on stable Rust: every reader of files against damaged, malicious and merely odd ones.

Inputs are mutations of a small corpus, blind to coverage but aware of structure: whole words and numbers are replaced,
JSON inside a binary file is changed and framed again, and checkpoints are sealed with a right checksum so that what lies
behind it is reached as well. Input `k` of a target is a function of `k` alone, so a failure is reproduced by its number:

```text
SUPPLE_FUZZ=1000000 cargo test --test fuzz [TARGET]      # executions of each target
SUPPLE_FUZZ_ONLY=4711 cargo test --test fuzz mjcf        # one input, which is printed
```

The targets run in processes of their own with at most 1 GiB of address space beyond the program itself; a process that
dies or stays with one input for long is a failure, and the input is named. Without `SUPPLE_FUZZ` every target runs for
a few seconds.
*/

mod mutate;
mod parent;
mod targets;

use std::process::ExitCode;

/// The repository.
const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn main() -> ExitCode {
    match std::env::var("SUPPLE_FUZZ_CHILD") {
        Ok(order) => parent::child(&order),
        Err(_) => parent::run_all(),
    }
}
