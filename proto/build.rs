//! Compiles `moldline/v1/*.proto` in Rust, so that nobody needs protoc.

use std::{env, error::Error, fs, path::PathBuf};

use prost::Message;

const FILES: [&str; 3] =
    ["moldline/v1/array.proto", "moldline/v1/quality.proto", "moldline/v1/mesh_service.proto"];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=moldline");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure().bytes(".moldline.v1.Array.data").compile_fds(descriptors)?;
    Ok(())
}
