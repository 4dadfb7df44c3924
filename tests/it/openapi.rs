//! The description at `/openapi.json`. That every answer of every other test stands in it is checked by the client of
//! `service.rs`; here is what the answers cannot show.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::service::{Client, Service};

fn description(client: &mut Client) -> Value {
    client.get("/openapi.json").expect(200).json()
}

/// Path and method of every operation that is described.
pub(crate) fn operations(description: &Value) -> Vec<(String, String, &Value)> {
    let paths = description["paths"].as_object().expect("paths");
    let of_path = |(path, item): (&String, &'_ Value)| {
        let item = item.as_object().expect("methods");
        item.keys().map(|method| (path.clone(), method.clone())).collect::<Vec<_>>()
    };
    let names: Vec<(String, String)> = paths.iter().flat_map(of_path).collect();
    names
        .into_iter()
        .map(|(path, method)| {
            let operation = &paths[&path][&method];
            (path, method, operation)
        })
        .collect()
}

#[test]
fn every_route_of_the_contract_is_described() {
    let service = Service::start();
    let description = description(&mut service.client());
    assert_eq!(description["openapi"], "3.1.0");
    let described: BTreeSet<String> = operations(&description)
        .into_iter()
        .map(|(path, method, _)| format!("{} {path}", method.to_uppercase()))
        .collect();
    let contract: BTreeSet<String> = [
        "GET /healthz",
        "GET /metrics",
        "GET /openapi.json",
        "GET /docs",
        "GET /docs/{asset}",
        "GET /problems/{code}",
        "GET /readyz",
        "GET /v1",
        "POST /v1/commands",
        "POST /v1/worlds/{world}/commands",
        "GET /v1/worlds",
        "POST /v1/worlds",
        "PUT /v1/worlds/{world}",
        "GET /v1/worlds/{world}",
        "PATCH /v1/worlds/{world}",
        "DELETE /v1/worlds/{world}",
        "POST /v1/worlds/{world}/advance",
        "GET /v1/worlds/{world}/digest",
        "POST /v1/worlds/{world}/forces",
        "GET /v1/worlds/{world}/particles",
        "POST /v1/worlds/{world}/particles",
        "PATCH /v1/worlds/{world}/particles",
        "GET /v1/worlds/{world}/particles/{id}",
        "PATCH /v1/worlds/{world}/particles/{id}",
        "DELETE /v1/worlds/{world}/particles/{id}",
        "PUT /v1/worlds/{world}/particles/{id}/mass",
        "POST /v1/worlds/{world}/particles/{id}/force",
        "POST /v1/worlds/{world}/particles/{id}/impulse",
        "POST /v1/worlds/{world}/particles/{id}/place",
        "GET /v1/worlds/{world}/particles/{id}/trajectory",
        "GET /v1/worlds/{world}/snapshot",
        "PUT /v1/worlds/{world}/snapshot",
        "GET /v1/worlds/{world}/state",
        "GET /v1/worlds/{world}/stream",
    ]
    .map(str::to_owned)
    .into();
    assert_eq!(described, contract);
}

/// The fuzzer starts inside every route.
#[test]
fn every_route_has_a_seed() {
    let seeds = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds/requests");
    let files =
        std::fs::read_dir(seeds).expect("the seeds of the fuzz target").map(|file| file.expect("a file").path());
    let text: String = files.map(|file| std::fs::read_to_string(file).expect("text")).collect();
    let requests: Vec<(&str, Vec<&str>)> = text
        .lines()
        .filter_map(|line| line.split_once(" /"))
        .map(|(method, path)| (method, path.split('?').next().unwrap_or_default().split('/').collect()))
        .collect();
    let service = Service::start();
    for (path, method, _) in operations(&description(&mut service.client())) {
        let parts: Vec<&str> = path[1..].split('/').collect();
        let fits = |other: &[&str]| {
            other.len() == parts.len()
                && parts.iter().zip(other).all(|(part, other)| part.starts_with('{') || part == other)
        };
        let found = requests.iter().any(|(verb, other)| verb.eq_ignore_ascii_case(&method) && fits(other));
        assert!(found, "fuzz/seeds/requests has no {method} {path}");
    }
}

/// The router has what is described, and under no other method.
#[test]
fn description_and_router_have_the_same_methods() {
    let service = Service::start();
    let mut client = service.client();
    let description = description(&mut client);
    for (path, _, _) in operations(&description) {
        let described: BTreeSet<String> = operations(&description)
            .into_iter()
            .filter(|(other, _, _)| *other == path)
            .map(|(_, method, _)| method.to_uppercase())
            .collect();
        let filled = path
            .replace("{world}", "a")
            .replace("{id}", "0")
            .replace("{code}", "diverged")
            .replace("{asset}", "swagger-ui.css");
        let answer = client.send("OPTIONS", &filled, &[], None).expect(405);
        let allowed: BTreeSet<String> = answer
            .header("allow")
            .expect("the methods")
            .split(',')
            .filter(|method| *method != "HEAD")
            .map(str::to_owned)
            .collect();
        assert_eq!(allowed, described, "{path}");
    }
}

#[test]
fn every_operation_is_complete() {
    let service = Service::start();
    let mut client = service.client();
    let description = description(&mut client);
    let mut ids = BTreeSet::new();
    for (path, method, operation) in operations(&description) {
        let place = format!("{method} {path}");
        assert!(operation["summary"].as_str().is_some_and(|summary| !summary.is_empty()), "{place} has no summary");
        assert!(ids.insert(operation["operationId"].as_str().expect("an id").to_owned()), "{place} repeats an id");
        let parameters = operation["parameters"].as_array().cloned().unwrap_or_default();
        let in_path = parameters.iter().filter(|parameter| parameter["in"] == "path").count();
        assert_eq!(in_path, path.matches('{').count(), "{place} describes the names in its path");
        for (status, response) in operation["responses"].as_object().expect("responses") {
            assert!(response["description"].as_str().is_some_and(|text| !text.is_empty()), "{place} {status}");
            let bare = matches!(status.as_str(), "101" | "204" | "303" | "304");
            assert_eq!(response["content"].is_object(), !bare, "{place} {status}");
        }
        let has_body = operation["requestBody"].is_object();
        assert_eq!(has_body, matches!(method.as_str(), "post" | "put" | "patch"), "{place}");
    }
    for (name, schema) in description["components"]["schemas"].as_object().expect("schemas") {
        assert_every_reference_resolves(&description, schema, name);
        if schema["type"] == "object" && name != "Worlds" && name != "Particles" && !name.starts_with("Service") {
            assert!(schema["example"].is_object(), "{name} has no example");
            let properties = schema["properties"].as_object().expect("properties");
            for field in schema["example"].as_object().expect("checked above").keys() {
                assert!(properties.contains_key(field), "{name}: {field} of the example is not a property");
            }
        }
    }
    assert_every_reference_resolves(&description, &description["paths"], "paths");
}

fn assert_every_reference_resolves(description: &Value, value: &Value, place: &str) {
    match value {
        Value::Object(object) => {
            if let Some(reference) = object.get("$ref").and_then(Value::as_str) {
                let target = description.pointer(reference.trim_start_matches('#'));
                assert!(target.is_some(), "{place}: {reference} leads nowhere");
            }
            object.values().for_each(|value| assert_every_reference_resolves(description, value, place));
        }
        Value::Array(list) => list.iter().for_each(|value| assert_every_reference_resolves(description, value, place)),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

/// The examples of the body that an operation takes, one for each of its shapes.
pub(crate) fn examples(description: &Value, operation: &Value) -> Vec<Value> {
    let schema = &operation["requestBody"]["content"]["application/json"]["schema"];
    let resolve = |schema: &Value| {
        let reference = schema["$ref"].as_str().map(|reference| reference.trim_start_matches('#').to_owned());
        reference.map_or_else(|| schema.clone(), |pointer| description.pointer(&pointer).expect("resolves").clone())
    };
    let schema = resolve(schema);
    let shapes =
        schema["oneOf"].as_array().map_or_else(|| vec![schema.clone()], |shapes| shapes.iter().map(resolve).collect());
    shapes.iter().map(|shape| shape["example"].clone()).filter(Value::is_object).collect()
}

/// The examples of requests are taken as they stand, or refused for what they would do, never for their shape.
#[test]
fn examples_of_requests_work() {
    let service = Service::start();
    let mut client = service.client();
    let description = description(&mut client);
    client.put("/v1/worlds/a", "").expect(201);
    client.post("/v1/worlds/a/particles", "{\"count\":3}").expect(201);
    let mut tried = 0;
    for (path, method, operation) in operations(&description) {
        for example in examples(&description, operation) {
            let world = if method == "put" && path.ends_with("{world}") { "b" } else { "a" };
            let path = path.replace("{world}", world).replace("{id}", "0");
            let answer = client.send(&method.to_uppercase(), &path, &[], Some(example.to_string().as_bytes()));
            assert!(answer.status < 300, "{method} {path} {example}: {}", answer.text());
            tried += 1;
        }
    }
    assert!(tried >= 12, "{tried} examples");
}

#[test]
fn the_page_needs_no_network() {
    let service = Service::start();
    let mut client = service.client();
    let page = client.get("/docs").expect(200);
    let mut pages = vec![("/docs".to_owned(), page.text().to_owned())];
    for (_, asset) in page.text().match_indices("./").map(|(at, _)| (at, &page.text()[at + 2..])) {
        let name: String = asset.chars().take_while(|c| c.is_ascii_alphanumeric() || "-._".contains(*c)).collect();
        let path = format!("/docs/{name}");
        let answer = client.get(&path).expect(200);
        if name == "swagger-initializer.js" {
            pages.push((path, answer.text().to_owned()));
        }
    }
    assert!(pages.iter().any(|(_, text)| text.contains("/openapi.json")), "the page is over the description");
    client.get("/docs/nothing.js").expect(404);
    for (path, text) in pages {
        assert!(!text.contains("http://") && !text.contains("https://"), "{path} reaches out: {text}");
    }
}
