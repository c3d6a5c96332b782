//! Deforms a mesh to several designs concurrently, and takes the gradient of the enclosed volume at each of them.
//!
//!     cargo run --release -p moldline-client --example sweep -- 127.0.0.1:50051 examples/e175 setup-motions.toml wing.translation

use std::{env, error::Error, process::ExitCode};

use moldline_client::{Client, CreateOptions, Design, Seeds};
use tokio::task::JoinSet;

const STEPS: usize = 5;

async fn sweep(address: &str, folder: &str, setup_file: &str, variable: &str) -> Result<(), Box<dyn Error>> {
    let client = Client::new(address)?;
    let options = CreateOptions {
        setup_file: setup_file.to_owned(),
        progress: Some(Box::new(|step| eprintln!("{:3.0} % {}", 100.0 * step.fraction, step.message))),
        ..CreateOptions::default()
    };
    let setup = client.create_setup(folder, options).await?;
    let index = setup.variable(variable).ok_or_else(|| format!("there is no variable {variable}"))?;
    let volume = setup.function("enclosed_volume").ok_or("the set-up has no enclosed volume")?;
    let (lower, upper) = (setup.variables[index].lower, setup.variables[index].upper);
    let session = setup.session("sweep").await?;

    let mut points = JoinSet::new();
    for step in 0..STEPS {
        let value = lower + (upper - lower) * step as f64 / (STEPS - 1) as f64;
        let (session, variable) = (session.clone(), variable.to_owned());
        let mut functions = vec![0.0; setup.functions.len()];
        functions[volume] = 1.0;
        points.spawn(async move {
            let moved = session.deform(Design::named([(variable.as_str(), value)])).await?;
            let gradient = session.vjp(&Seeds { functions, ..Seeds::default() }, &moved).await?;
            Ok::<_, moldline_client::Error>((value, moved, gradient))
        });
    }
    let mut results: Vec<_> = points.join_all().await.into_iter().collect::<Result<_, _>>()?;
    results.sort_by(|(one, ..), (other, ..)| one.total_cmp(other));
    let (unit, function) = (&setup.variables[index].unit, &setup.functions[volume]);
    for (value, moved, gradient) in results {
        println!(
            "{value:+.3} {unit}: aspect ratio p95 {:.3}, {} {:.4} {}, its derivative {:+.5}",
            moved.quality.total.aspect_ratio.p95,
            function.name,
            moved.functions[volume],
            function.unit,
            gradient.design[index],
        );
    }
    session.close().await?;
    Ok(())
}

#[tokio::main]
async fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [address, folder, setup_file, variable] = &arguments[..] else {
        eprintln!("usage: sweep ADDRESS FOLDER SETUP_FILE VARIABLE");
        return ExitCode::FAILURE;
    };
    match sweep(address, folder, setup_file, variable).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
