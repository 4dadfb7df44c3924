//! Run time against error, for every integrator, scene and precision.
//!
//! `cargo bench --bench accuracy` takes some minutes and writes `docs/accuracy.md`, `docs/accuracy.csv` and the table of
//! `docs/integrators.md`. `cargo bench --bench accuracy -- kepler` measures one scene, and writes below
//! the folder of the build. Without `--bench`, as in `cargo test`, everything runs once at small size and is checked.

#![expect(clippy::print_stdout, reason = "the tables are what it is for")]
#![expect(clippy::cast_precision_loss, reason = "counts of steps and particles are far below 2⁵³")]

mod growth;
#[path = "../shared/host.rs"]
mod host;
mod measure;
mod method;
mod report;
mod scenes;
mod stability;
#[path = "../shared/table.rs"]
mod table;
mod work;

use std::path::Path;

use report::Results;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |wanted: &str| arguments.iter().any(|argument| argument == wanted);
    let measuring = has("--bench") && !has("--test");
    if !measuring && has("--list") {
        return; // For test runners: it is one check without a name.
    }
    let small = !measuring;
    let filter: Vec<&String> = arguments.iter().filter(|argument| !argument.starts_with("--")).collect();
    let wanted = |name: &str| filter.is_empty() || filter.iter().any(|filter| name.contains(filter.as_str()));

    let mut results = Results::default();
    let scenes = scenes::all();
    for spec in &work::SPECS {
        for scene in scenes.iter().filter(|scene| scene.name == spec.name && wanted(spec.name)) {
            let points = work::measure(spec, scene, small);
            if small {
                work::check(&points);
            } else {
                println!("{}, {}", spec.title, scene.precision);
            }
            results.points.extend(points);
        }
    }
    for scene in scenes.iter().filter(|scene| ["base", "weak"].contains(&scene.name.as_str()) && wanted(growth::LONG)) {
        results.curves.extend(growth::long(scene, small));
    }
    for scene in scenes.iter().filter(|scene| scene.name == "kepler" && wanted(growth::ORBITS)) {
        results.curves.extend(growth::orbits(scene, small));
    }
    let is_outer = |scene: &&scenes::Scene| scene.name == "outer" && scene.precision == pointmass::Precision::Double;
    for scene in scenes.iter().filter(|scene| is_outer(scene) && wanted(growth::ENERGY)) {
        results.curves.extend(growth::energy(scene, small));
    }
    if wanted("stability") {
        results.rows = stability::measure(small);
    }
    if small {
        let files = report::files(&results).expect("everything can be written");
        assert!(files.iter().all(|(name, text)| !text.contains("NaN") && !name.is_empty()), "a number is missing");
        return;
    }
    println!("\n{}", report::print(&results));
    // Only a whole run is worth recording.
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let folder = if filter.is_empty() { docs.clone() } else { Path::new(env!("CARGO_TARGET_TMPDIR")).join("accuracy") };
    report::write(&results, &folder).expect("the folder can be written");
    if folder == docs {
        report::write_guide(&results, &docs).expect("docs/ can be written");
    }
    println!("written: {}", folder.display());
}
