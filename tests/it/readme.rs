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
        ("| steps of an advance | ", "steps_max"),
        ("| steps x particles of an advance | ", "particle_steps_max"),
        ("| interactions of an advance, under gravitation | ", "interactions_max"),
    ] {
        assert!(README.contains(&format!("{row}{} |", thousands(name))), "{name} is {}", thousands(name));
    }
    assert_eq!((limits["body_bytes_max"].as_u64(), limits["connections_max"].as_u64()), (Some(64 << 20), Some(1024)));
    assert_eq!(
        (limits["header_timeout_ms"].as_u64(), limits["body_timeout_ms"].as_u64()),
        (Some(30_000), Some(30_000))
    );
}
