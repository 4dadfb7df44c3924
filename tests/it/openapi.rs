//! The description at `/openapi.json`. That every answer of every other test stands in it is checked by the client of
//! `service.rs`; here is what the answers cannot show.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use crate::service::{Answer, Client, Service, check_shape, shape_name};

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
        "GET /",
        "GET /healthz",
        "GET /metrics",
        "GET /openapi.json",
        "GET /docs",
        "GET /docs/",
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
            .replace("{asset}", "start.js");
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
        if schema["type"] == "object" {
            assert_eq!(schema["additionalProperties"], false, "{name} takes what is not described");
            let is_long = name == "Worlds" || name == "Particles" || name.starts_with("Service");
            assert!(is_long || schema["example"].is_object(), "{name} has no example");
        }
        if let Some(example) = schema.get("example") {
            check_shape(name, example, &format!("the example of {name}"));
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

/// Every value in a document, with the way to it.
fn walk(value: &Value, place: &str, visit: &mut impl FnMut(&Value, &str)) {
    visit(value, place);
    match value {
        Value::Object(object) => object.iter().for_each(|(key, value)| walk(value, &format!("{place}/{key}"), visit)),
        Value::Array(list) => {
            (0..).zip(list).for_each(|(k, value): (usize, _)| walk(value, &format!("{place}/{k}"), visit));
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

/// Names of the `OpenAPI` format registry, and texts that a stranger understands.
#[test]
fn formats_and_words_are_those_of_readers() {
    let service = Service::start();
    let description = description(&mut service.client());
    let (mut formats, mut texts) = (BTreeSet::new(), 0);
    walk(&description, "", &mut |value, place| {
        if let Some(format) = value.get("format").and_then(Value::as_str) {
            let kind = if value["type"].is_array() { &value["type"][0] } else { &value["type"] };
            formats.insert(format!("{} {format}", kind.as_str().unwrap_or_default()));
        }
        if let Some(text) = value.get("description").and_then(Value::as_str) {
            texts += 1;
            for word in ["OpenAPI", "this description", "schema"] {
                assert!(!text.contains(word), "{place} speaks of {word}: {text}");
            }
        }
    });
    let known =
        ["integer int32", "integer int64", "integer uint16", "integer uint32", "integer uint64", "number double"];
    let known: BTreeSet<String> = known.into_iter().chain(["string binary"]).map(str::to_owned).collect();
    assert!(formats.is_subset(&known), "{formats:?}");
    assert!(texts > 200, "{texts} texts");
    for (method, content) in [("get", "responses/200"), ("put", "requestBody")] {
        let place =
            format!("/paths/~1v1~1worlds~1{{world}}~1snapshot/{method}/{content}/content/application~1octet-stream");
        let schema = &description.pointer(&place).expect("a snapshot")["schema"];
        assert_eq!(description["components"]["schemas"][shape_name(schema)]["format"], "binary", "{place}");
    }
    // An id goes beyond what an int64 holds.
    let ids = [&description["components"]["schemas"]["Particle"]["properties"]["id"], &path_id(&description)["schema"]];
    for id in ids {
        assert_eq!((&id["format"], &id["minimum"]), (&json!("uint64"), &json!(0)));
    }
}

fn path_id(description: &Value) -> &Value {
    let parameters = &description["paths"]["/v1/worlds/{world}/particles/{id}"]["get"]["parameters"];
    parameters.as_array().expect("parameters").iter().find(|parameter| parameter["name"] == "id").expect("an id")
}

/// Clients take the first media type: a page that tries the routes, and generators.
#[test]
fn json_stands_before_cbor() {
    let service = Service::start();
    let answer = service.client().get("/openapi.json").expect(200);
    let mut contents = 0;
    for content in answer.text().split("\"content\": {").skip(1) {
        let first = content.split('"').nth(1).expect("a media type");
        assert_ne!(first, "application/cbor");
        contents += usize::from(first == "application/json" && content.contains("\"application/cbor\""));
    }
    assert!(contents > 30, "{contents} times both");
}

/// Each refusal shows what it looks like, under its own status and code.
#[test]
fn every_refusal_has_an_example_of_its_own() {
    let service = Service::start();
    let description = description(&mut service.client());
    let mut seen = BTreeSet::new();
    for (path, method, operation) in operations(&description) {
        for (status, response) in operation["responses"].as_object().expect("responses") {
            let Some(content) = response["content"].get("application/problem+json") else {
                assert!(status.as_str() < "400", "{method} {path} {status} shows no problem");
                continue;
            };
            let examples = content["examples"].as_object().expect("examples");
            assert!(!examples.is_empty(), "{method} {path} {status}");
            for (code, example) in examples {
                let pointer = example["$ref"].as_str().expect("shared by all routes").trim_start_matches('#');
                let value = &description.pointer(pointer).expect("resolves")["value"];
                assert_eq!(
                    (&value["code"], value["status"].to_string()),
                    (&json!(code), status.clone()),
                    "{method} {path}"
                );
                check_shape("Problem", value, pointer);
                seen.insert(code.clone());
            }
        }
    }
    // Whoever goes by the description sends no other method.
    seen.insert("method_not_allowed".to_owned());
    assert!(description["components"]["examples"].as_object().expect("examples").keys().eq(&seen), "{seen:?}");
}

/// A request as a page makes it whose reader only presses its buttons: every parameter that has an example has that, and
/// the body is the first example.
fn first_try(client: &mut Client, description: &Value, path: &str, method: &str, operation: &Value) -> Answer {
    let (mut filled, mut query) = (path.to_owned(), Vec::new());
    for parameter in operation["parameters"].as_array().into_iter().flatten() {
        let name = parameter["name"].as_str().expect("a name");
        let example = parameter.get("example");
        let example = example.map(|example| example.as_str().map_or_else(|| example.to_string(), str::to_owned));
        if parameter["in"] == "path" {
            filled = filled.replace(&format!("{{{name}}}"), &example.expect("a value to begin with"));
        } else if parameter["in"] == "query" {
            query.extend(example.map(|example| format!("{name}={example}")));
        }
    }
    if !query.is_empty() {
        filled = filled + "?" + &query.join("&");
    }
    let body = examples(description, operation).first().map(Value::to_string);
    client.send(&method.to_uppercase(), &filled, &[], body.as_deref().map(str::as_bytes))
}

/// On a service without worlds, from its creation on: what the page shows is taken as it stands.
#[test]
fn the_first_try_works() {
    let service = Service::start();
    let mut client = service.client();
    let description = description(&mut client);
    let order = |path: &str, method: &str| match (method, path) {
        ("put", "/v1/worlds/{world}") => 0,
        ("post", "/v1/worlds/{world}/particles") => 1,
        ("delete", "/v1/worlds/{world}") => 4,
        ("delete", _) => 3,
        _ => 2,
    };
    let mut all = operations(&description);
    all.sort_by_key(|(path, method, _)| order(path, method));
    for (path, method, operation) in all {
        // A stream does not end, and a snapshot to restore is a file of the reader's own.
        if path.ends_with("/stream") || (method.as_str(), path.ends_with("/snapshot")) == ("put", true) {
            continue;
        }
        let answer = first_try(&mut client, &description, &path, &method, operation);
        assert!(answer.status < 400, "{method} {path}: {} {}", answer.status, answer.text());
    }
}
