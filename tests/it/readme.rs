//! README.md keeps its word: its commands, run as they stand, answer what stands below them. Only the port differs.

use std::process::Command;

use crate::service::Service;

const README: &str = include_str!("../../README.md");

/// Every `console` block: a command after `$ `, and below it what it prints.
fn commands() -> Vec<(String, String)> {
    let mut commands: Vec<(String, String)> = Vec::new();
    for block in README.split("```console\n").skip(1) {
        for line in block.split("```").next().expect("split has a first part").lines() {
            if let Some(command) = line.strip_prefix("$ ") {
                commands.push((command.to_owned(), String::new()));
            } else {
                let (_, printed) = commands.last_mut().expect("a block begins with a command");
                *printed += line;
                *printed += "\n";
            }
        }
    }
    commands
}

#[test]
fn its_commands_answer_what_it_says() {
    let service = Service::start();
    let commands = commands();
    assert!(commands.len() >= 12, "{} commands", commands.len());
    for (command, printed) in commands {
        let here = command.replace("localhost:8080", &service.address.to_string());
        let output = Command::new("sh").args(["-c", &here]).output().expect("sh");
        assert!(output.status.success(), "{here}: {}; is curl installed?", String::from_utf8_lossy(&output.stderr));
        assert_eq!(String::from_utf8_lossy(&output.stdout), printed, "{command}");
    }
}

#[test]
fn its_tables_name_what_there_is() {
    for integrator in pointmass::Integrator::ALL {
        assert!(README.contains(&format!("| `{integrator}`")), "{integrator} is not in the table");
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
        assert!(README.contains(&format!("{row}{} |", thousands(name))), "{name} is {}", thousands(name));
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
    ] {
        assert!(README.contains(row), "{row}");
        assert_eq!(limits[name], value, "{name}");
    }
}
