//! `calibrig columns`.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::{CliError, Verdict, print, say};
use calibrig_files::{RowOptions, suggest_columns};

/// What the columns of measurement files mean
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig columns suggest grid.csv
  calibrig columns suggest joints.csv smr1.txt smr2.txt smr3.txt --out map.toml")]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Suggest(SuggestArgs),
}

/// Write a column map from what is found in files, each guess with its reason
///
/// Every line of the map says why it is there: a name in the header, the unit after it, the size of the numbers. What cannot be found, such as
/// a unit that the numbers do not reveal, is left in a comment `# DECIDE:`, and the map is refused until it is decided. Joints in one file and
/// points in others are joined by name, row or time, whichever the files allow.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  calibrig columns suggest grid.csv
  calibrig columns suggest grid.csv --out map.toml
  calibrig columns suggest joints.csv points.txt --out map.toml
  calibrig columns suggest shots.xlsx --sheet Points
  calibrig identify --model robot.toml --measurements grid.csv --columns map.toml

Exit code 3 if something is left to decide.")]
struct SuggestArgs {
    /// Files of measurements that belong together
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Sheet of an XLSX file [default: the first]
    #[arg(long, value_name = "NAME")]
    sheet: Option<String>,
    /// File for the map, which must not exist yet [default: standard output]
    #[arg(long, value_name = "MAP.toml")]
    out: Option<PathBuf>,
}

pub(super) fn execute(args: &Args) -> Result<Verdict, CliError> {
    let What::Suggest(args) = &args.what;
    let paths: Vec<&Path> = args.files.iter().map(PathBuf::as_path).collect();
    let options = RowOptions { sheet: args.sheet.clone(), ..RowOptions::default() };
    let map = suggest_columns(&paths, &options)?;
    match &args.out {
        Some(path) => {
            write_new(path, &map.text)?;
            say(&format!("wrote {}", path.display()));
        }
        None => print(&map.text)?,
    }
    for open in &map.open {
        say(&format!("to decide: {open}"));
    }
    Ok(if map.open.is_empty() { Verdict::Done } else { Verdict::Doubtful })
}

/// Writes a file that does not exist yet.
fn write_new(path: &Path, text: &str) -> Result<(), CliError> {
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    match file.and_then(|mut file| file.write_all(text.as_bytes())) {
        Ok(()) => Ok(()),
        Err(_) if path.exists() => Err(CliError::NamedAlready { path: path.to_path_buf() }),
        Err(source) => Err(CliError::Output { what: path.display().to_string(), source }),
    }
}
