/*! Free memory of the machine, and of the control groups (containers, Slurm jobs, systemd services) that this process is in.

A group's usage counts the pages of files that were read or written in it, which the kernel gives back on demand: after a build
in a container it is near the limit although the memory is free.
*/

use std::path::{Component, Path, PathBuf};

/// Free memory \[bytes\].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FreeMemory {
    /// Free memory, and pages of files that were not used of late.
    pub surely: u64,
    /// Memory that can be had at most: also pages of files in use, caches of the kernel, and swap.
    pub at_most: u64,
}

/// Names of the files of a memory control group.
struct Group {
    limit: &'static str,
    usage: &'static str,
    inactive_files: &'static str,
    /// Keys of `memory.stat` that the kernel gives back under pressure.
    rest: &'static [&'static str],
}

const VERSION_1: Group = Group {
    limit: "memory.limit_in_bytes",
    usage: "memory.usage_in_bytes",
    inactive_files: "total_inactive_file",
    rest: &["total_active_file"],
};

const VERSION_2: Group = Group {
    limit: "memory.max",
    usage: "memory.current",
    inactive_files: "inactive_file",
    rest: &["active_file", "slab_reclaimable"],
};

impl FreeMemory {
    /// Returns the free memory; `None` if the system does not report it.
    pub fn now() -> Option<Self> {
        Self::under(Path::new("/"))
    }

    /// Reads the folders `proc` and `sys` in `root`.
    fn under(root: &Path) -> Option<Self> {
        let machine = std::fs::read_to_string(root.join("proc/meminfo")).unwrap_or_default();
        let kibibytes = |key: &str| number_after(&machine, key).map(|number| number.saturating_mul(1024));
        let swap = kibibytes("SwapFree:").unwrap_or(0);
        let of_machine =
            kibibytes("MemAvailable:").map(|free| FreeMemory { surely: free, at_most: free.saturating_add(swap) });
        let groups = std::fs::read_to_string(root.join("proc/self/cgroup")).unwrap_or_default();
        let of_groups = groups.lines().flat_map(|line| folders(line, &root.join("sys/fs/cgroup")));
        let all = of_machine.into_iter().chain(of_groups.filter_map(|(kind, folder)| of_group(&kind, &folder, swap)));
        all.reduce(|a, b| FreeMemory { surely: a.surely.min(b.surely), at_most: a.at_most.min(b.at_most) })
    }
}

/// Returns the folders of a line of `/proc/self/cgroup` (`number:controllers:path`): the group and those that it lies in, if they
/// bound memory. In a container, the path may be that outside of it, and only the last folder exists.
fn folders(line: &str, mount: &Path) -> Vec<(Group, PathBuf)> {
    let mut parts = line.splitn(3, ':').skip(1);
    let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { return Vec::new() };
    let of_memory = controllers.split(',').any(|controller| controller == "memory");
    let mount = if of_memory { mount.join("memory") } else { mount.to_owned() };
    if !of_memory && !controllers.is_empty() {
        return Vec::new();
    }
    let path: PathBuf = Path::new(path).components().filter(|part| matches!(part, Component::Normal(_))).collect();
    let kind = || if of_memory { VERSION_1 } else { VERSION_2 };
    path.ancestors().map(|part| (kind(), mount.join(part))).collect()
}

/// Returns the free memory of a group; `None` if it has no limit.
fn of_group(kind: &Group, folder: &Path, swap: u64) -> Option<FreeMemory> {
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).ok();
    let number = |name: &str| read(name)?.trim().parse::<u64>().ok();
    let (limit, usage) = (number(kind.limit)?, number(kind.usage)?);
    let statistics = read("memory.stat").unwrap_or_default();
    let given_back = |key: &str| number_after(&statistics, key).unwrap_or(0);
    let inactive = given_back(kind.inactive_files);
    let rest: u64 = kind.rest.iter().map(|key| given_back(key)).fold(swap, u64::saturating_add);
    let surely = limit.saturating_sub(usage.saturating_sub(inactive));
    let at_most = limit.saturating_sub(usage.saturating_sub(inactive.saturating_add(rest)));
    Some(FreeMemory { surely, at_most })
}

/// Returns the number after a word at the start of a line.
fn number_after(text: &str, word: &str) -> Option<u64> {
    let mut lines = text.lines().map(str::split_whitespace);
    lines.find_map(|mut words| if words.next() == Some(word) { words.next()?.parse().ok() } else { None })
}

/// Formats a size in GiB.
pub fn gibibytes(bytes: u64) -> String {
    let gibibytes = bytes as f64 / f64::from(1 << 30);
    let digits = if gibibytes < 10.0 { 2 } else { 1 };
    format!("{gibibytes:.digits$} GiB")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns what is free in a system of these files.
    fn free(files: &[(&str, &str)]) -> FreeMemory {
        let root = tempfile::tempdir().unwrap();
        let machine = ("proc/meminfo", "MemTotal: 9000 kB\nMemAvailable:    4000 kB\nSwapFree: 1 kB\n");
        for (path, text) in [machine].iter().chain(files) {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        FreeMemory::under(root.path()).unwrap()
    }

    #[test]
    fn without_groups_the_machine_decides() {
        let machine = FreeMemory { surely: 4000 << 10, at_most: 4001 << 10 };
        assert_eq!(free(&[]), machine);
        // Without a limit, or with version 1's word for none.
        assert_eq!(free(&[("proc/self/cgroup", "0::/a\n"), ("sys/fs/cgroup/a/memory.max", "max\n")]), machine);
        let none = [
            ("proc/self/cgroup", "5:cpu,memory:/\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n"),
            ("sys/fs/cgroup/memory/memory.usage_in_bytes", "5\n"),
        ];
        assert_eq!(free(&none), machine);
    }

    #[test]
    fn pages_of_files_are_given_back() {
        // 100,000 of 100,000 bytes are used, 60,000 of them by files of which a third is in use, and 5000 by the kernel.
        let container = [
            ("proc/self/cgroup", "0::/\n"),
            ("sys/fs/cgroup/memory.max", "100000\n"),
            ("sys/fs/cgroup/memory.current", "100000\n"),
            ("sys/fs/cgroup/memory.stat", "file 60000\ninactive_file 40000\nactive_file 20000\nslab_reclaimable 5000"),
        ];
        assert_eq!(free(&container), FreeMemory { surely: 40000, at_most: 65000 + 1024 });
    }

    #[test]
    fn the_tightest_group_around_a_process_counts() {
        // A job of Slurm: the step has no limit, the job has one, the machine's is wider.
        let nested = [
            ("proc/self/cgroup", "0::/slurm/job_7/step_0\n"),
            ("sys/fs/cgroup/slurm/job_7/step_0/memory.max", "max\n"),
            ("sys/fs/cgroup/slurm/job_7/memory.max", "3000\n"),
            ("sys/fs/cgroup/slurm/job_7/memory.current", "1000\n"),
            ("sys/fs/cgroup/slurm/memory.max", "900000\n"),
            ("sys/fs/cgroup/slurm/memory.current", "1000\n"),
        ];
        assert_eq!(free(&nested).surely, 2000);
        let version_1 = [
            ("proc/self/cgroup", "3:cpuset:/x\n9:memory:/slurm/job_7/step_0\n0::/\n"),
            ("sys/fs/cgroup/memory/slurm/job_7/memory.limit_in_bytes", "3000\n"),
            ("sys/fs/cgroup/memory/slurm/job_7/memory.usage_in_bytes", "2000\n"),
            ("sys/fs/cgroup/memory/slurm/job_7/memory.stat", "total_inactive_file 500\ntotal_active_file 200\n"),
        ];
        assert_eq!(free(&version_1), FreeMemory { surely: 1500, at_most: 1700 + 1024 });
        // A container of version 1 sees the path outside of it, and its own group as the root.
        let container = [
            ("proc/self/cgroup", "9:memory:/docker/0123\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "3000\n"),
            ("sys/fs/cgroup/memory/memory.usage_in_bytes", "2500\n"),
        ];
        assert_eq!(free(&container).surely, 500);
    }
}
