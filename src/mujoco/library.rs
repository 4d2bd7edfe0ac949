//! The file of the MuJoCo library that is loaded.

use std::path::PathBuf;

/// Returns the file that MuJoCo was loaded from; `None` where the operating system does not report it.
pub fn library_file() -> Option<PathBuf> {
    let maps = std::fs::read_to_string("/proc/self/maps").ok()?;
    let address = mujoco_sys::mj_version as *const () as usize;
    maps.lines().find_map(|line| file_at(line, address))
}

/// Returns the file of a line of `/proc/self/maps` that contains an address: `7f31-7f32 r-xp 00000000 fe:00 42   /lib/x.so`.
fn file_at(line: &str, address: usize) -> Option<PathBuf> {
    let (first, last) = line.split_once(' ')?.0.split_once('-')?;
    let bound = |text| usize::from_str_radix(text, 16).ok();
    let inside = (bound(first)?..bound(last)?).contains(&address);
    inside.then(|| line.find('/').map(|start| PathBuf::from(&line[start..])))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loaded_library_is_a_file_of_that_name() {
        let file = library_file().unwrap();
        assert!(file.file_name().unwrap().to_string_lossy().starts_with("libmujoco.so"), "{}", file.display());
        assert!(file.is_file());
    }

    #[test]
    fn lines_of_other_addresses_are_passed_over() {
        let line = "1000-2000 r-xp 00000000 fe:00 42      /opt/my libs/libmujoco.so.2.2.2";
        assert_eq!(file_at(line, 0x1fff), Some("/opt/my libs/libmujoco.so.2.2.2".into()));
        assert_eq!((file_at(line, 0x2000), file_at("1000-2000 rw-p 00000000 00:00 0", 0x1000)), (None, None));
    }
}
