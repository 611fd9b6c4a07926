//! A folder of its own with copies of the shipped models and scenarios, in which the binary runs.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

pub const SCENARIO: &str = "scenarios/paper.toml";
pub const ROBOT: &str = "models/spray_painter/robot.toml";
pub const URDF: &str = "models/spray_painter/robot.urdf";

const COMPENSATION: &str = "# --- Compensation ---";
const PUBLISHED: &str = "# --- Published tables ---";

pub struct Sandbox {
    folder: TempDir,
}

/// How a process ended.
#[derive(Debug)]
pub struct Ended {
    /// `None` after a signal.
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl From<Output> for Ended {
    fn from(output: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is UTF-8");
        Self { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

impl Ended {
    /// The JSON document on stdout, which holds nothing else.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error}: {self:?}"))
    }
}

impl Sandbox {
    pub fn new() -> Self {
        let sandbox = Self::with(&["models", "scenarios"]);
        sandbox.switch_effects_off();
        sandbox.switch_instrument_off();
        sandbox.drive_nothing_again();
        sandbox
    }

    /// With everything as it is in the repository, recordings too.
    pub fn as_shipped() -> Self {
        Self::with(&["models", "scenarios", "recordings"])
    }

    fn with(folders: &[&str]) -> Self {
        let sandbox = Self { folder: tempfile::tempdir().expect("a temporary folder") };
        for folder in folders {
            copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join(folder), &sandbox.path(folder));
        }
        sandbox
    }

    /// The same with the shipped scenario as it is but for the machine's effects and the instrument's errors: its corrected commands are driven as well.
    pub fn driving_again() -> Self {
        let sandbox = Self::new();
        let shipped =
            fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(SCENARIO)).expect("the scenario");
        let (_, section) = shipped.split_once(COMPENSATION).expect("the section");
        let (section, _) = section.split_once(PUBLISHED).expect("the tables behind it");
        let text = sandbox.read(SCENARIO).replace(PUBLISHED, &format!("{COMPENSATION}{section}{PUBLISHED}"));
        sandbox.write(SCENARIO, text);
        sandbox
    }

    /// Takes the corrected commands out of the shipped scenario: a run of a test drives its session alone.
    fn drive_nothing_again(&self) {
        let text = self.read(SCENARIO);
        let (before, section) = text.split_once(COMPENSATION).expect("the section");
        let (_, behind) = section.split_once(PUBLISHED).expect("the tables behind it");
        self.write(SCENARIO, format!("{before}{PUBLISHED}{behind}"));
    }

    /// Leaves the tracker of the shipped scenario its noise alone: what else it does is larger than what is left of the machine without its effects.
    fn switch_instrument_off(&self) {
        let mut text =
            self.read(SCENARIO).replace("systematic_fraction = 0.2\n", "systematic_fraction = 0\n");
        for section in ["environment", "smr", "drift"] {
            let header = format!("[tracker.{section}]\n");
            assert!(text.contains(&header), "{SCENARIO} has no {header}");
            text = text.replace(&header, &format!("{header}enabled = false\n"));
        }
        self.write(SCENARIO, text);
    }

    /// Takes the effects out of the shipped scenario, so that tests of single sections and of long sessions can put in their own.
    fn switch_effects_off(&self) {
        let text = self.read(SCENARIO);
        let (machine, rest) =
            text.split_once("# --- What no table of link parameters holds").expect("the effects");
        let (_, rest) = rest.split_once("# --- Poses").expect("the poses behind them");
        self.write(SCENARIO, format!("{machine}# --- Poses{rest}"));
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).unwrap_or_else(|error| panic!("{name}: {error}"));
    }

    pub fn make_folder(&self, name: &str) {
        fs::create_dir_all(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    }

    /// Replaces the first line behind the line `marker` that begins with `start` by `line` (nothing where that is empty); the number of
    /// the line, from 1. Without a marker it is sought from the top.
    #[track_caller]
    pub fn replace_line(&self, file: &str, marker: &str, start: &str, line: &str) -> usize {
        let text = self.read(file);
        let mut lines: Vec<&str> = text.lines().collect();
        let from = match marker {
            "" => 0,
            _ => lines
                .iter()
                .position(|l| *l == marker)
                .unwrap_or_else(|| panic!("{file} has no line {marker}")),
        };
        let at = lines[from..].iter().position(|l| l.trim_start().starts_with(start));
        let at = from + at.unwrap_or_else(|| panic!("{file} has no {start} behind {marker}"));
        if line.is_empty() {
            lines.remove(at);
        } else {
            lines[at] = line;
        }
        self.write(file, lines.join("\n") + "\n");
        at + 1
    }

    /// Gives the key of the shipped scenario another value.
    #[track_caller]
    pub fn set(&self, marker: &str, key: &str, value: &str) -> usize {
        self.replace_line(SCENARIO, marker, &format!("{key} = "), &format!("{key} = {value}"))
    }

    pub fn command<A: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = A>) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_calibrig"));
        command.current_dir(self.folder.path()).args(arguments).stdin(Stdio::null());
        command
    }

    pub fn run<A: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = A>) -> Ended {
        self.command(arguments).output().expect("the binary starts").into()
    }

    /// Every file and folder with its content.
    pub fn content(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut content = BTreeMap::new();
        gather(self.folder.path(), &mut content);
        content
    }
}

fn gather(folder: &Path, content: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            gather(&path, content);
            content.insert(path, Vec::new());
        } else {
            content.insert(path.clone(), fs::read(&path).expect("a file"));
        }
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder of the repository") {
        let path = entry.expect("an entry").path();
        let target = to.join(path.file_name().expect("a name"));
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, &target).expect("copied");
        }
    }
}

/// The process refused its input: exit code 1, nothing on stdout, no file made or changed, and one error, on stderr, that begins with
/// `place` and holds `message` in its first line and `expected` in its help.
#[track_caller]
pub fn assert_refused(sandbox: &Sandbox, arguments: &[&str], place: &str, message: &str, expected: &str) {
    let before = sandbox.content();
    let ended = sandbox.run(arguments);
    let context = format!("{arguments:?} ended with {:?}:\n{}{}", ended.code, ended.stdout, ended.stderr);
    assert_eq!(ended.code, Some(1), "{context}");
    assert_eq!(ended.stdout, "", "{context}");
    let first = ended.stderr.lines().next().unwrap_or_default();
    assert!(first.starts_with(&format!("error: {place}")), "{place} is not where the error is: {context}");
    assert!(first.contains(message), "{message:?} is not in the message: {context}");
    let help = ended.stderr.lines().find_map(|line| line.trim_start().strip_prefix("help: "));
    assert!(help.is_some_and(|help| help.contains(expected)), "{expected:?} is not in the help: {context}");
    assert_eq!(ended.stderr.matches("error: ").count(), 1, "{context}");
    for noise in ["panicked", "Some(", "Err(", "serde", "f64", "u64"] {
        assert!(!ended.stderr.contains(noise), "{noise}: {context}");
    }
    assert!(sandbox.content() == before, "files were made or changed: {context}");
}
