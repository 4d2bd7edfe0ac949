//! `policy describe`: writes the YAML file of an external policy from the file of its framework.

use std::path::{Path, PathBuf};

use anyhow::Context;
use supple::policy::external;
use supple::util::files::{self, Target};
use supple::util::terminal;

/// Place of the network from the folder of a `deploy.yaml`, in Unitree's frameworks.
const NETWORK: &str = "../exported/policy.onnx";

/// Writes the description of the policy in `source` to `out`, checked with its network if that is there.
pub fn describe(source: &Path, onnx: Option<PathBuf>, robot: Option<&str>, out: &Path) -> anyhow::Result<()> {
    let target = Target::of(out).with_context(|| format!("cannot write {}", out.display()))?;
    let is_file = matches!(target, Target::File(_));
    let exists = is_file && std::fs::symlink_metadata(out).is_ok();
    anyhow::ensure!(!exists, "{} exists already: choose another --out, or move it away", out.display());
    let onnx = onnx.unwrap_or_else(|| match source.extension() {
        Some(extension) if extension.eq_ignore_ascii_case("onnx") => source.to_owned(),
        _ => source.parent().unwrap_or(Path::new("")).join(NETWORK),
    });
    let name = from_folder(&onnx, out.parent().unwrap_or(Path::new("")))?;
    let text = external::translate(source, name.to_str().context("the path is not UTF-8")?, robot)?;
    let has_network = external::check(out, &text).with_context(|| format!("cannot describe {}", source.display()))?;
    if !is_file {
        return crate::write(out, text.as_bytes());
    }
    files::write_new(out, |file| file.write_all(text.as_bytes()))
        .with_context(|| format!("cannot write {}", out.display()))?;
    let (out, onnx) = (out.display(), onnx.display());
    let checked = if has_network {
        format!("it fits {onnx}")
    } else {
        format!("not checked with the network: there is no {onnx}, name it with --onnx or in {out}")
    };
    let marked = text.matches("check this").count();
    terminal::print(format_args!("{out}: {checked}; check the {marked} marked lines, then `policy show {out}`\n"))?;
    Ok(())
}

/// Returns the path of a file from a folder: relative if the file is within it, absolute if not or if it does not exist.
fn from_folder(file: &Path, folder: &Path) -> anyhow::Result<PathBuf> {
    let here = std::path::absolute(folder.join(".")).with_context(|| folder.display().to_string())?;
    let (here, file) = match (std::fs::canonicalize(&here), std::fs::canonicalize(file)) {
        (Ok(here), Ok(file)) => (here, file),
        _ => (here, std::path::absolute(file).with_context(|| file.display().to_string())?),
    };
    Ok(file.strip_prefix(&here).map(Path::to_owned).unwrap_or(file))
}
