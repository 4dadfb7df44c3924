//! README.md and docs/ keep their word: their commands, run as they stand, answer what stands below them. Only the port
//! differs.

use std::path::Path;
use std::process::Command;

use crate::service::Service;

const README: &str = include_str!("../../README.md");
const HTTP: &str = include_str!("../../docs/http.md");
const OPERATING: &str = include_str!("../../docs/operating.md");

/// Every `console` block: a command after `$ `, which goes on after `> `, and below it what it prints.
fn commands(page: &str) -> Vec<(String, String)> {
    let mut commands: Vec<(String, String)> = Vec::new();
    for block in page.split("```console\n").skip(1) {
        for line in block.split("```").next().expect("split has a first part").lines() {
            if let Some(command) = line.strip_prefix("$ ") {
                commands.push((command.to_owned(), String::new()));
                continue;
            }
            let (command, printed) = commands.last_mut().expect("a block begins with a command");
            if let Some(more) = line.strip_prefix("> ") {
                *command = format!("{command}\n{more}");
            } else {
                *printed = format!("{printed}{line}\n");
            }
        }
    }
    commands
}

#[test]
fn commands_answer_what_pages_say() {
    for (page, least) in [(README, 11), (HTTP, 12)] {
        let service = Service::start();
        let commands = commands(page);
        assert!(commands.len() >= least, "{} commands", commands.len());
        for (command, printed) in commands {
            let here = command.replace("localhost:8080", &service.address.to_string());
            let output = Command::new("sh").args(["-c", &here]).output().expect("sh");
            let problem = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{here}: {problem}; is curl installed?");
            assert_eq!(String::from_utf8_lossy(&output.stdout), printed, "{command}");
        }
    }
}

/// A crate beside the repository that depends on it as README.md says.
#[test]
fn its_dependency_brings_no_network() {
    let (_, block) = README.split_once("```toml\n").expect("it has a dependency to paste");
    let (dependency, _) = block.split_once("```").expect("blocks end");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("readme");
    let game = folder.join("game");
    std::fs::create_dir_all(game.join("src")).expect("a folder of the build");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let clone = folder.join("pointmass");
    if !clone.exists() {
        std::os::unix::fs::symlink(root, &clone).expect("a folder of the build");
    }
    let manifest = format!("[package]\nname = \"game\"\nedition = \"2024\"\n[workspace]\n{dependency}");
    std::fs::write(game.join("Cargo.toml"), manifest).expect("a folder of the build");
    std::fs::write(game.join("src/lib.rs"), "").expect("a folder of the build");
    // With the versions that are there, so that nothing has to be fetched.
    std::fs::copy(root.join("Cargo.lock"), game.join("Cargo.lock")).expect("a folder of the build");
    let cargo = Command::new(env!("CARGO")).args(["tree", "--offline", "-e", "normal"]).current_dir(&game).output();
    let output = cargo.expect("the tests are run by cargo");
    let tree = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(tree.contains("pointmass") && !tree.contains("tokio"), "{tree}");
}

/// Files that pages link to or show, and sections of pages.
#[test]
fn links_lead_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files =
        std::fs::read_dir(root).expect("the repository").chain(std::fs::read_dir(root.join("docs")).expect("docs/"));
    let read =
        |path: &Path| std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut links = 0;
    for path in
        files.map(|file| file.expect("readable").path()).filter(|path| path.extension().is_some_and(|e| e == "md"))
    {
        for link in read(&path).split("](").skip(1).map(|rest| rest.split(')').next().expect("split has a first part"))
        {
            if link.contains("://") {
                continue;
            }
            let (file, section) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { path.clone() } else { path.parent().expect("a folder").join(file) };
            assert!(target.exists(), "{} links to {link}, which is not there", path.display());
            let heading = |line: &str| line.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
            let is_there = section.is_empty()
                || read(&target).lines().any(|line| line.starts_with('#') && heading(line) == section);
            assert!(is_there, "{} links to {link}, a section that is not there", path.display());
            links += 1;
        }
    }
    assert!(links > 40, "{links} links");
}

#[test]
fn tables_name_what_there_is() {
    for integrator in pointmass::Integrator::ALL {
        assert!(README.contains(&format!("| `{integrator}`")), "{integrator} is not in the table");
    }
    for (name, gravity) in pointmass::gravity::PRESETS {
        let told = [format!("`{name}` ({gravity} m/s²"), format!("`{name}` ({gravity})")];
        assert!(told.iter().any(|told| README.contains(told)), "{name} is {gravity}");
    }
    let service = Service::start();
    let limits = service.client().get("/v1").json()["limits"].clone();
    let thousands = |name: &str| {
        let digits = limits[name].to_string();
        let grouped: Vec<&str> =
            digits.as_bytes().rchunks(3).rev().map(|d| std::str::from_utf8(d).expect("digits")).collect();
        grouped.join(",")
    };
    for (row, name) in [
        ("| worlds | ", "worlds_max"),
        ("| particles of a world | ", "particles_max"),
        ("| commands of a batch | ", "commands_max"),
        ("| steps of an advance, or of all of a batch | ", "steps_max"),
        ("| steps x particles of them | ", "particle_steps_max"),
        ("| interactions of them, under gravitation | ", "interactions_max"),
    ] {
        assert!(OPERATING.contains(&format!("{row}{} |", thousands(name))), "{name} is {}", thousands(name));
    }
    for (row, name, value) in [
        ("| bytes of a body | 64 MiB", "body_bytes_max", 64_i64 << 20),
        ("| bytes of a snapshot to restore | 256 MiB", "snapshot_bytes_max", 256 << 20),
        ("| bytes of an answer | 256 MiB", "answer_bytes_max", 256 << 20),
        (
            "| bytes of all bodies, with what they are parsed into, and answers in flight | 2 GiB",
            "in_flight_bytes_max",
            2_i64 << 30,
        ),
        ("| connections; from one address beyond loopback | 1024; 64", "connections_max", 1024),
        ("| connections; from one address beyond loopback | 1024; 64", "address_connections_max", 64),
        ("| requests at once on one connection (HTTP/2) | 100", "streams_max", 100),
        ("| bytes of a path, of the headers | 16 KiB", "uri_bytes_max", 16 << 10),
        ("| bytes of a path, of the headers | 16 KiB", "header_bytes_max", 16 << 10),
        ("| seconds for headers, for a body | 5, 30", "header_timeout_ms", 5_000),
        ("| seconds for headers, for a body | 5, 30", "body_timeout_ms", 30_000),
        ("| seconds without a request; for an answer, and one for each MiB of it | 30", "idle_timeout_ms", 30_000),
        ("| seconds without a request; for an answer, and one for each MiB of it | 30", "write_timeout_ms", 30_000),
        ("| requests that wait for one world, for a processor | 256, 1024", "world_queue_max", 256),
        ("| requests that wait for one world, for a processor | 256, 1024", "queue_max", 1024),
        ("| seconds in a queue; for a processor, when the work is short | 30; 0.1", "queue_timeout_ms", 30_000),
        ("| seconds in a queue; for a processor, when the work is short | 30; 0.1", "shed_after_ms", 100),
        ("keeps the answers of its last 1,024 changes with a key", "keys_max", 1024),
        ("for ten minutes", "key_lifetime_ms", 600_000),
        ("up to 1,000,000 particles", "particles_max", 1_000_000),
        ("10,000 worlds in 2 GiB", "worlds_max", 10_000),
        ("10,000 worlds in 2 GiB", "memory_bytes_max", 2_i64 << 30),
        ("a batch 10,000 commands", "commands_max", 10_000),
        ("an advance 1,000,000 steps", "steps_max", 1_000_000),
        ("a body 64 MiB", "body_bytes_max", 64_i64 << 20),
    ] {
        assert!(OPERATING.contains(row) || HTTP.contains(row) || README.contains(row), "{row}");
        assert_eq!(limits[name], value, "{name}");
    }
}
