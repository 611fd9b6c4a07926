//! Compiles the messages of a recording: Rust types, and the descriptors that every recording carries as its schema.

use std::error::Error;
use std::path::PathBuf;

const FOLDER: &str = "src";
const SCHEMA: &str = "calibrig.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed={FOLDER}/{SCHEMA}");
    let mut compiler = protox::Compiler::new([FOLDER])?;
    compiler.include_source_info(true).open_file(SCHEMA)?;
    prost_build::Config::new().enable_type_names().compile_fds(compiler.file_descriptor_set())?;
    // The comments are for the generated code; the schema in a recording goes without them.
    let descriptors = compiler.include_source_info(false).encode_file_descriptor_set();
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
    std::fs::write(out.join("calibrig.v1.descriptors"), descriptors)?;
    Ok(())
}
