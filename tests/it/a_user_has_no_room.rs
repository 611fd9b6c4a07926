//! Disks that are full and folders that cannot be written to, while a run is recorded.

use std::path::Path;
use std::process::Command;

use crate::sandbox::{Ended, SCENARIO, Sandbox};

/// Runs the shipped scenario into a file system of `kilobytes` kB, and then `after` in it; `None` where the system lets nobody but root
/// mount one, and this test is skipped.
fn run_with_room(sandbox: &Sandbox, kilobytes: u32, after: &str) -> Option<Ended> {
    sandbox.make_folder("small");
    let script = format!(
        "mount -t tmpfs -o size={kilobytes}k tmpfs small || exit 77
         \"$0\" run {SCENARIO} --out small/out
         code=$?
         {after}
         exit $code"
    );
    let run = Command::new("unshare")
        .args(["--map-root-user", "--mount", "sh", "-c", &script, env!("CARGO_BIN_EXE_calibrig")])
        .current_dir(sandbox.path(""))
        .output();
    match run {
        Ok(output) if output.status.code() != Some(77) && !unshared_nothing(&output.stderr) => {
            Some(output.into())
        }
        _ => {
            eprintln!("SKIPPED: this system lets no test mount a small file system (`unshare --mount`)");
            None
        }
    }
}

fn unshared_nothing(stderr: &[u8]) -> bool {
    String::from_utf8_lossy(stderr).contains("unshare:")
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_does_not_lose_the_result() {
    let sandbox = Sandbox::new();
    let whole = sandbox.run(["run", SCENARIO, "--out", "whole"]);
    let size = |name: &str| std::fs::metadata(sandbox.path("whole").join(name)).map_or(0, |file| file.len());
    let reports = size("report.html") + size("report.json") + size("residuals.csv");
    let last = if cfg!(feature = "rerun") { size("recording.rrd") } else { reports };
    let all = reports + size("recording.mcap") + if cfg!(feature = "rerun") { last } else { 0 };
    // Nothing fits; half of the session's recording does; all but the file that is written last does.
    for bytes in [16_384, size("recording.mcap") / 2, all - last / 2] {
        let kilobytes = u32::try_from(bytes / 1024).expect("small");
        let Some(ended) = run_with_room(&sandbox, kilobytes, "ls -A small small/out 2>/dev/null >&2") else {
            return;
        };
        assert_eq!(ended.code, Some(1), "{kilobytes} kB: {ended:?}");
        assert_eq!(ended.stdout, whole.stdout, "{kilobytes} kB: the tables are complete");
        let told =
            |text: &str| assert!(ended.stderr.contains(text), "{kilobytes} kB, {text:?}: {}", ended.stderr);
        told("some files could not be written to small/out");
        told("No space left on device");
        told("the result is on standard output");
        assert!(!ended.stderr.contains(".part"), "{kilobytes} kB: {}", ended.stderr);
        assert!(!ended.stderr.contains("panicked"), "{kilobytes} kB: {}", ended.stderr);
    }
}

#[cfg(target_os = "linux")]
#[test]
fn what_does_fit_is_whole() {
    let sandbox = Sandbox::new();
    assert_eq!(sandbox.run(["run", SCENARIO, "--out", "whole"]).code, Some(0));
    // Room for the recording, not for the reports beside it.
    let recording = std::fs::metadata(sandbox.path("whole/recording.mcap")).expect("written").len();
    let kilobytes = u32::try_from(recording / 1024 + 100).expect("small");
    let Some(ended) = run_with_room(&sandbox, kilobytes, "cp -r small/out kept") else { return };
    assert_eq!(ended.code, Some(1), "{ended:?}");
    let kept: Vec<_> = std::fs::read_dir(sandbox.path("kept"))
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("a name"))
        .collect();
    assert!(
        !kept.is_empty() && kept.iter().all(|name| !name.contains("part") && !name.starts_with('.')),
        "{kept:?}"
    );
    for name in &kept {
        assert!(ended.stderr.contains(name.as_str()), "{name}: {}", ended.stderr);
    }
    if kept.iter().any(|name| name == "recording.mcap") {
        assert_eq!(sandbox.run(["replay", "kept/recording.mcap"]).code, Some(0));
    }
}

#[cfg(unix)]
#[test]
fn a_folder_that_cannot_be_written_to_is_told_before_anything_is_simulated() {
    use std::os::unix::fs::PermissionsExt;
    let sandbox = Sandbox::new();
    sandbox.make_folder("out");
    let allow = |mode| std::fs::set_permissions(sandbox.path("out"), std::fs::Permissions::from_mode(mode));
    allow(0o555).expect("set");
    if std::fs::write(sandbox.path("out/probe"), "").is_ok() {
        eprintln!("SKIPPED: this user may write to folders that nobody may write to");
        return;
    }
    let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
    allow(0o755).expect("set");
    assert_eq!((ended.code, ended.stdout.as_str()), (Some(1), ""), "{ended:?}");
    assert!(
        ended.stderr.contains("cannot write") && ended.stderr.contains("Permission denied"),
        "{}",
        ended.stderr
    );
}

/// A device that takes nothing.
#[cfg(target_os = "linux")]
#[test]
fn a_result_that_nobody_takes_is_told() {
    if !Path::new("/dev/full").exists() {
        eprintln!("SKIPPED: this system has no /dev/full");
        return;
    }
    let sandbox = Sandbox::new();
    let full = std::fs::File::options().write(true).open("/dev/full").expect("opened");
    let mut run = sandbox.command(["run", SCENARIO, "--out", "out"]);
    let ended: Ended = run.stdout(full).output().expect("the binary starts").into();
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert!(ended.stderr.contains("standard output"), "{}", ended.stderr);
    assert!(sandbox.path("out/recording.mcap").exists(), "the files are there all the same");
}
