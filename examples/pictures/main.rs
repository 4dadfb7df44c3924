//! Draws every picture of `docs/` anew: what was measured, from the CSV that a benchmark has written, and the one at the
//! top of README.md, from worlds.
//!
//! `cargo run --example pictures` writes them. `cargo test` compares what stands there with what
//! would be written.

mod accuracy;
mod chart;
mod csv;
mod engine;
mod service;
mod svg;
mod throws;

use std::error::Error;
use std::path::{Path, PathBuf};

use csv::Recorded;

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs")
}

/// By name.
fn pictures(docs: &Path) -> Result<Vec<(String, String)>, Box<dyn Error>> {
    let mut pictures = vec![
        ("throws.svg".to_owned(), throws::draw()?),
        ("wire.svg".to_owned(), service::wire(&Recorded::read(docs, "wire"))),
        ("load.svg".to_owned(), service::load(&Recorded::read(docs, "load"))),
    ];
    pictures.extend(engine::draw(&Recorded::read(docs, "benchmarks")));
    pictures.extend(accuracy::draw(&Recorded::read(docs, "accuracy")));
    Ok(pictures)
}

fn main() -> Result<(), Box<dyn Error>> {
    let docs = docs();
    for (name, text) in pictures(&docs)? {
        std::fs::write(docs.join(name), text)?;
    }
    Ok(())
}

#[test]
fn pictures_are_those_of_what_was_measured() {
    let docs = docs();
    let pictures = pictures(&docs).expect("the worlds are valid");
    for (name, text) in &pictures {
        let there = std::fs::read_to_string(docs.join(name)).unwrap_or_default();
        assert!(there == *text, "docs/{name} is another: cargo run --example pictures");
    }
    let mut files = std::fs::read_dir(&docs).expect("docs/").map(|file| file.expect("readable").file_name());
    let stray = files.find(|file| {
        let file = file.to_string_lossy();
        file.ends_with(".svg") && !pictures.iter().any(|(name, _)| *name == file)
    });
    assert_eq!(stray, None, "a picture that nothing draws");
}
