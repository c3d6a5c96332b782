//! The compiled clients: their prerequisites and their builds.

use std::{
    fs,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
};

use crate::{
    packages::{self, succeeds},
    process::{Outcome, cargo, command, root, run},
};

/// Debian packages of the tools and libraries that the C++ client needs.
const PACKAGES: [&str; 6] =
    ["cmake", "g++", "protobuf-compiler", "protobuf-compiler-grpc", "libprotobuf-dev", "libgrpc++-dev"];

/// Programs that drive the clients, and an example that uses the installed C++ client.
#[derive(Debug)]
pub struct Clients {
    /// The Rust client's driver.
    pub rust: PathBuf,
    /// The C++ client's driver.
    pub cpp: PathBuf,
    /// The C++ client's example.
    pub optimizer: PathBuf,
}

impl Clients {
    /// Builds the drivers of the end-to-end tests, installs the C++ client below `target/`, and builds its example against
    /// that installation.
    pub fn built() -> Outcome<Self> {
        // With the features of the whole workspace, as in the tests, so that nothing is compiled twice.
        let mut rust = cargo();
        rust.args(["build", "--locked", "--workspace", "--example", "driver", "--example", "sweep"]);
        run("Rust client's driver and example", &mut rust)?;
        let (library, prefix, examples) =
            (root().join("target/cpp"), root().join("target/cpp/prefix"), root().join("target/cpp-examples"));
        let mut configure = cmake();
        configure
            .args(["-S", "client/cpp", "-DMOLDLINE_WERROR=ON", "-DMOLDLINE_TESTS=ON", "-B"])
            .arg(&library);
        if !succeeds(&mut configure) {
            packages::install(
                &PACKAGES,
                "the C++ client does not configure without CMake, a C++17 compiler, protobuf and gRPC",
            )?;
            // CMake caches missing libraries.
            let _ = fs::remove_file(library.join("CMakeCache.txt"));
            run("configure the C++ client", &mut configure)?;
        }
        build("C++ client and driver", &library)?;
        run("install the C++ client", cmake().arg("--install").arg(&library).arg("--prefix").arg(&prefix))?;
        let mut configure = cmake();
        configure.args(["-S", "client/cpp/examples", "-B"]).arg(&examples);
        configure.arg(format!("-DCMAKE_PREFIX_PATH={}", prefix.display()));
        run("configure the C++ example", configure.stdout(Stdio::null()))?;
        build("C++ example", &examples)?;
        Ok(Self {
            rust: root().join("target/debug/examples/driver"),
            cpp: library.join("moldline-driver"),
            optimizer: examples.join("moldline-optimizer"),
        })
    }

    /// Passes the paths to the end-to-end tests.
    pub fn tell<'a>(&self, tests: &'a mut Command) -> &'a mut Command {
        tests
            .env("MOLDLINE_DRIVER_RUST", &self.rust)
            .env("MOLDLINE_DRIVER_CPP", &self.cpp)
            .env("MOLDLINE_OPTIMIZER", &self.optimizer)
    }
}

fn cmake() -> Command {
    command("cmake")
}

fn build(title: &str, folder: &Path) -> Outcome {
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get).to_string();
    run(title, cmake().arg("--build").arg(folder).args(["--parallel", &cores]))
}
