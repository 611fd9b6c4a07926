//! Tests of the files as a whole, and the outcomes that all tests of the report have in common.

pub(in crate::report) mod pages;
pub(in crate::report) mod sample;

use std::collections::{BTreeMap, BTreeSet};

use super::*;

#[test]
fn all_files_are_written_and_no_other() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_reports(&sample::simulated(), folder.path()).expect("a report");
    write_reports(&sample::simulated(), folder.path()).expect("a report over an older one");
    let mut names: Vec<_> = std::fs::read_dir(folder.path())
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
        .collect();
    names.sort();
    assert_eq!(names, ["report.html", "report.json", "residuals.csv"]);
    let read = |name| std::fs::read_to_string(folder.path().join(name)).expect("readable");
    assert!(read("report.html").ends_with("</html>"));
    let json: JsonReport = serde_json::from_str(&read("report.json")).expect("the schema");
    assert_eq!(json.schema, SCHEMA);
}

#[test]
fn a_folder_that_cannot_be_written_to_keeps_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let missing = folder.path().join("missing");
    let error = write_reports(&sample::measured(), &missing).expect_err("there is no folder");
    assert!(error.to_string().contains("report.json"), "{error}");
    // A folder stands in the way of the second file: the first may be there, but no temporary file is.
    std::fs::create_dir(folder.path().join("report.html")).expect("a folder");
    assert!(write_reports(&sample::measured(), folder.path()).is_err());
    for entry in std::fs::read_dir(folder.path()).expect("the folder") {
        let name = entry.expect("an entry").file_name().into_string().expect("UTF-8");
        assert!(
            ["report.html", "report.json", "residuals.csv"].contains(&name.as_str()),
            "{name} is left behind"
        );
    }
}

#[cfg(unix)]
#[test]
fn others_may_read_what_the_umask_allows() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let plain = folder.path().join("plain");
    std::fs::write(&plain, "").expect("a file");
    write_reports(&sample::measured(), folder.path()).expect("a report");
    let mode = |path: &Path| std::fs::metadata(path).expect("a file").permissions().mode();
    assert_eq!(mode(&folder.path().join("report.json")), mode(&plain));
}

/// Numbers and words below, figures and sections above them, pages on top: no file needs one that needs it.
#[test]
fn the_files_of_the_report_stand_in_an_order() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/report");
    let mut needs: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("the folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_stem().expect("a name").to_string_lossy().into_owned();
        let files: Vec<_> = if path.is_dir() {
            std::fs::read_dir(&path).expect("a folder").map(|entry| entry.expect("an entry").path()).collect()
        } else {
            vec![path]
        };
        for file in files.iter().filter(|file| file.extension().is_some_and(|ending| ending == "rs")) {
            let start = if files.len() > 1 { "use crate::report::" } else { "use super::" };
            let text = std::fs::read_to_string(file).expect("readable");
            let modules = text.lines().filter_map(|line| line.strip_prefix(start)?.split([':', ';']).next());
            needs.entry(name.clone()).or_default().extend(modules.map(str::to_owned));
        }
    }
    needs.retain(|name, _| name != "mod" && name != "tests");
    assert!(needs.len() > 30 && needs["html"].contains("trust"), "{needs:?}");
    while !needs.is_empty() {
        let known: BTreeSet<String> = needs.keys().cloned().collect();
        let is_free = |own: &BTreeSet<String>, name: &str| {
            own.iter().all(|other| other == name || !known.contains(other))
        };
        needs.retain(|name, own| !is_free(own, name));
        assert!(needs.len() < known.len(), "in a circle: {known:?}");
    }
}
