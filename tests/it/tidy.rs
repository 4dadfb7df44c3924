//! The tree itself: what a reader relies on without looking.

use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn files(folder: &str, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of the project") {
            let path = entry.expect("readable").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.to_string_lossy().ends_with(ending) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

fn read(path: impl AsRef<Path>) -> String {
    let path = root().join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn only_the_server_names_the_network() {
    for path in files("src", ".rs") {
        let inside = path.strip_prefix(root()).expect("ours").to_string_lossy().into_owned();
        if inside.starts_with("src/server") || inside == "src/main.rs" {
            continue;
        }
        for word in ["axum", "tower", "tokio::", "serde", "hyper", "utoipa", "crate::server"] {
            assert!(!read(&path).contains(word), "{inside} names {word}; the network belongs to src/server");
        }
    }
}

#[test]
fn imports_point_down() {
    // From the top to the bottom; modules inside one row do not import each other, except in the last.
    let layers: &[&[&str]] = &[
        &["world"],
        &["system"],
        &["closed_form", "kernel", "particles", "command"],
        &[
            "error",
            "filled",
            "accumulators",
            "base_times",
            "column",
            "forces",
            "ids",
            "integrator",
            "real",
            "prefetch",
            "shared",
            "double_double",
            "registry",
            "threads",
        ],
    ];
    let layer = |module: &str| layers.iter().position(|modules| modules.contains(&module));
    for path in files("src", ".rs") {
        let inside = path.strip_prefix(root().join("src")).expect("ours").with_extension("");
        let module = inside.iter().next().expect("a name").to_string_lossy().into_owned();
        let Some(own) = layer(&module) else { continue };
        for line in read(&path).lines().filter_map(|line| line.strip_prefix("use crate::")) {
            let other = line.split([':', ';']).next().expect("a module");
            // What a precision can do includes the engine that is compiled for it.
            if other == module || (module.as_str(), line) == ("real", "world::Compiled;") {
                continue;
            }
            let other_layer = layer(other).unwrap_or_else(|| panic!("{module} imports {other}, which has no layer"));
            let down = other_layer > own || (other_layer == own && own == layers.len() - 1);
            assert!(down, "src/{module}.rs imports {other}: see the layers in ARCHITECTURE.md");
        }
    }
}

#[test]
fn nothing_is_left_for_later() {
    for path in files("src", ".rs").into_iter().chain(files("tests", ".rs")).chain(files("fuzz/fuzz_targets", ".rs")) {
        if path.ends_with("tidy.rs") {
            continue;
        }
        for (number, line) in read(&path).lines().enumerate() {
            let place = format!("{}:{}", path.display(), number + 1);
            for word in ["TODO", "FIXME", "XXX", "dbg!(", "mul_add("] {
                assert!(!line.contains(word), "{place} has {word}");
            }
            assert!(line.len() <= 200, "{place} is {} bytes long", line.len());
            assert!(!line.ends_with(' '), "{place} ends with a space");
        }
    }
}

#[test]
fn the_image_uses_flags_and_paths_that_exist() {
    let config = read("src/server/config.rs");
    let image = read("docker/Dockerfile") + &read("docker/compose.yaml");
    let words = image.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
    let variables: Vec<&str> = words.filter(|word| word.starts_with("POINTMASS_")).collect();
    assert!(variables.contains(&"POINTMASS_LISTEN"), "the image says where it listens");
    for variable in variables {
        assert!(
            config.contains(&format!("\"{variable}\"")),
            "docker/ sets {variable}, which the service does not know"
        );
    }
    for line in read("docker/Dockerfile").lines().filter(|line| line.starts_with("COPY ") && !line.contains("--from")) {
        let mut words: Vec<&str> = line.split_whitespace().skip(1).collect();
        words.pop();
        for source in words.into_iter().filter(|word| !word.starts_with("--")) {
            assert!(root().join(source).exists(), "docker/Dockerfile copies {source}, which is not there");
        }
    }
    let image = read("docker/Dockerfile");
    for needed in ["HEALTHCHECK", "\"healthcheck\"", "USER ", "POINTMASS_LISTEN=0.0.0.0:8080", "EXPOSE 8080"] {
        assert!(image.contains(needed), "docker/Dockerfile has no {needed}");
    }
    let ignored = read("docker/Dockerfile.dockerignore");
    assert!(
        ignored.lines().any(|line| line.starts_with("target") || line.starts_with("/target") || line == "*"),
        "the build folder stays out"
    );
}
