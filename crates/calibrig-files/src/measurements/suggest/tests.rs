//! No file makes a suggestion panic.

use proptest::prelude::*;

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn no_text_panics(text in "([XYZJ0-9a-z .,;:\\t\n\\[\\]\"#/-]|J1|-9999|\\[mm\\]|\\PC){0,200}", other in "([0-9;.\n]|Name){0,60}") {
        let folder = tempfile::tempdir().expect("a folder");
        let paths = [("a.csv", text), ("b.csv", other)].map(|(name, text)| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect("written");
            path
        });
        for files in [&paths[..1], &paths[..]] {
            let files: Vec<&Path> = files.iter().map(std::path::PathBuf::as_path).collect();
            match suggest_columns(&files, &RowOptions::default()) {
                Ok(map) => {
                    // What is written is a map, or says at which key it is none: it is TOML in any case.
                    let source = crate::Source::new("map.toml", map.text.clone());
                    let parsed: Result<toml::Table, _> = toml::from_str(&source.text);
                    prop_assert!(parsed.is_ok(), "{parsed:?}\n{}", map.text);
                    let _ = crate::parse_column_map(&source);
                }
                Err(error) => prop_assert!(!error.to_string().is_empty()),
            }
        }
    }
}
