//! Without the `record` feature there is nothing to record with.

use supple::agent::Agent;
use supple::scenario::catalog::Scenario;
use supple::scenario::{Played, Script};
use supple::terminal;
use supple::trace::Trace;

use crate::args::Args;

/// No recording.
pub struct Recording;

impl Recording {
    pub fn start(args: &Args, _: &Scenario, _: &[(String, Agent)], _: &[Script]) -> anyhow::Result<Self> {
        if args.record.is_some() || args.connect.is_some() || args.serve.is_some() || args.on_fall.is_some() {
            anyhow::bail!("this program was built without recordings; build it with --features record");
        }
        if !args.no_record {
            terminal::note("note: this program was built without recordings (feature `record`)");
        }
        Ok(Recording)
    }

    pub fn add(&mut self, _: usize, _: &Played) -> anyhow::Result<()> {
        Ok(())
    }

    pub fn finish(
        self,
        _: &Args,
        _: &Scenario,
        _: &[(String, Agent)],
        _: &[Script],
        _: &[Trace],
    ) -> anyhow::Result<()> {
        Ok(())
    }
}
