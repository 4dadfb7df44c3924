//! Who may come in: tokens, and pages of other origins.

use std::fs::{File, Permissions, read_to_string, set_permissions};
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use pointmass::World;
use pointmass::server::{App, Config, Tokens};
use serde_json::Value;

use crate::command_line::{Running, pointmass, temporary};
use crate::openapi::{examples, operations};
use crate::service::{Answer, Client, Service};

const FULL: &str = "full-0123456789abcdef";
const READ_ONLY: &str = "read-0123456789abcdef";
const VARIABLE: &str = "full-of-the-environment";
const SECOND_VARIABLE: &str = "second-of-the-environment";
const READ_ONLY_VARIABLE: &str = "read-of-the-environment";
const ROTATED_AWAY: &str = "full-of-yesterday-0123";

/// A token file of the test's own, removed at its end.
struct TokenFile(PathBuf);

impl TokenFile {
    fn new(name: &str, text: &str) -> Self {
        let file = Self(temporary(name));
        file.write(text);
        file
    }

    fn write(&self, text: &str) {
        std::fs::write(&self.0, text).expect("a file");
        set_permissions(&self.0, Permissions::from_mode(0o600)).expect("ours");
    }
}

impl Drop for TokenFile {
    fn drop(&mut self) {
        let _gone = std::fs::remove_file(&self.0);
    }
}

fn command(tokens: Option<&Path>, variables: &[(&str, &str)]) -> Command {
    let mut command = pointmass();
    command.args(["--listen", "127.0.0.1:0"]).envs(variables.iter().copied());
    if let Some(path) = tokens {
        command.arg("--token-file").arg(path);
    }
    command
}

fn start(tokens: Option<&Path>, variables: &[(&str, &str)]) -> Running {
    Running::start(command(tokens, variables))
}

fn bearer(token: &str) -> String {
    format!("Bearer {token}")
}

#[track_caller]
fn send(client: &mut Client, token: &str, method: &str, path: &str, body: Option<&str>) -> Answer {
    client.send(method, path, &[("authorization", &bearer(token))], body.map(str::as_bytes))
}

/// What a credential is good for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Good {
    Nothing,
    Reads,
    Everything,
}

/// The refusal that a credential meets; `None` is through to the route.
fn refusal(good: Good, is_open: bool, is_read: bool) -> Option<(u16, &'static str)> {
    match (good, is_open, is_read) {
        (_, true, _) | (Good::Everything, ..) | (Good::Reads, _, true) => None,
        (Good::Nothing, ..) => Some((401, "unauthorized")),
        (Good::Reads, _, false) => Some((403, "read_only_token")),
    }
}

/// Routes that tell no secret; every other is closed, also one that is new.
const OPEN: [&str; 8] =
    ["/", "/docs", "/docs/", "/docs/{asset}", "/openapi.json", "/healthz", "/readyz", "/problems/{code}"];

/// Whatever is described, and what is not, with every method and every credential.
#[test]
fn every_route_holds_every_credential() {
    let file = TokenFile::new("matrix", &format!("{ROTATED_AWAY}\n"));
    let full = format!("{VARIABLE}, {SECOND_VARIABLE}");
    let variables = [("POINTMASS_TOKEN", full.as_str()), ("POINTMASS_READ_ONLY_TOKEN", READ_ONLY_VARIABLE)];
    let mut running = start(Some(&file.0), &variables);
    let address = running.address();
    let mut client = Client::connect(address);
    send(&mut client, ROTATED_AWAY, "GET", "/v1", None).expect(200);
    file.write(&format!("# of today\n\n  {FULL}\nread-only  {READ_ONLY}\n"));
    running.signal("HUP");
    running.logged("read the token file again");

    let description = send(&mut client, FULL, "GET", "/openapi.json", None).expect(200).json();
    let described = operations(&description);
    let mut paths: Vec<&str> = described.iter().map(|(path, _, _)| path.as_str()).chain(["/nowhere"]).collect();
    paths.dedup();
    let credentials: Vec<(Option<String>, Good)> = [(None, Good::Nothing)]
        .into_iter()
        .chain(
            [
                "Bearer wrong",
                "Bearer ",
                "Bearer read-only",
                &bearer(&FULL[1..]),
                &bearer(ROTATED_AWAY),
                &bearer(&full),
                &format!("Bearer read-only {READ_ONLY}"),
                &format!("Basic {FULL}"),
                FULL,
            ]
            .map(|header| (Some(header.to_owned()), Good::Nothing)),
        )
        .chain([READ_ONLY, READ_ONLY_VARIABLE].map(|token| (Some(bearer(token)), Good::Reads)))
        .chain([FULL, VARIABLE, SECOND_VARIABLE].map(|token| (Some(bearer(token)), Good::Everything)))
        .collect();
    let mut changes = 0;
    for path in paths {
        for method in ["GET", "HEAD", "OPTIONS", "PUT", "POST", "PATCH", "DELETE", "PURGE"] {
            let operation = described.iter().find(|(p, m, _)| p == path && m.eq_ignore_ascii_case(method));
            let example = operation.and_then(|(.., operation)| examples(&description, operation).into_iter().next());
            let is_restore = method == "PUT" && path.ends_with("/snapshot");
            let body = if is_restore {
                Some(snapshot())
            } else {
                example.map(|json| json.to_string().replace("demo", "a").into_bytes())
            };
            let is_read = matches!(method, "GET" | "HEAD" | "OPTIONS");
            for (authorization, good) in &credentials {
                let request = Request { method, path, authorization: authorization.as_deref(), body: body.as_deref() };
                assert!(!request.path().contains('{'), "a part of {path} needs a value here");
                let before = prepare(&mut client);
                let answer = request.send(address);
                let context = format!("{request:?}: {} {}", answer.status, String::from_utf8_lossy(&answer.body));
                let expected = refusal(*good, OPEN.contains(&path), is_read);
                if let Some((status, code)) = expected {
                    assert_eq!(answer.status, status, "{context}");
                    if method != "HEAD" {
                        assert_eq!(answer.json()["code"], code, "{context}");
                    }
                    let challenge = answer.header("www-authenticate");
                    assert_eq!(challenge, (status == 401).then_some("Bearer"), "{context}");
                } else {
                    assert!(!matches!(answer.status, 401 | 403), "{context}");
                }
                let is_change = expected.is_none() && !is_read && operation.is_some();
                if is_change {
                    // So the same request has shown above that it changes nothing when it is refused.
                    assert!(answer.status < 300, "{context}");
                    changes += 1;
                }
                assert_eq!(worlds(&mut client) != before, is_change, "{context}");
                if let Some((status, _)) = expected {
                    request.send_head(address).expect(status);
                }
            }
        }
    }
    assert!(changes >= 3 * 14, "{changes} changes");
}

#[derive(Debug)]
struct Request<'a> {
    method: &'a str,
    path: &'a str,
    authorization: Option<&'a str>,
    body: Option<&'a [u8]>,
}

impl Request<'_> {
    fn path(&self) -> String {
        let world = if self.method == "PUT" && self.path.ends_with("{world}") { "b" } else { "a" };
        // A stream that is followed does not end.
        [("{world}/stream", "{world}/stream?rate=0"), ("{world}", world), ("{id}", "0"), ("{code}", "diverged")]
            .into_iter()
            .chain([("{asset}", "start.js")])
            .fold(self.path.to_owned(), |path, (name, value)| path.replace(name, value))
    }

    #[track_caller]
    fn send(&self, address: SocketAddr) -> Answer {
        let headers: Vec<_> = self.authorization.map(|value| ("authorization", value)).into_iter().collect();
        Client::connect(address).send(self.method, &self.path(), &headers, self.body)
    }

    /// Announces a body that never comes: it has to be answered without.
    #[track_caller]
    fn send_head(&self, address: SocketAddr) -> Answer {
        let mut client = Client::connect(address);
        client.impatient(Duration::from_secs(10));
        let authorization = self.authorization.map(|value| format!("authorization: {value}\r\n")).unwrap_or_default();
        let (method, path) = (self.method, self.path());
        client.raw(
            format!("{method} {path} HTTP/1.1\r\nhost: localhost\r\n{authorization}content-length: 9\r\n\r\n")
                .as_bytes(),
        );
        client.answer(method == "HEAD")
    }
}

/// What can be restored.
fn snapshot() -> Vec<u8> {
    let mut bytes = Vec::new();
    World::<f64>::default().snapshot(&mut bytes).expect("a vector takes all");
    bytes
}

/// One world `a` with a particle, and no other.
fn prepare(client: &mut Client) -> Value {
    let present = worlds(client);
    if present["worlds"].as_array().is_some_and(|worlds| worlds.len() == 1 && worlds[0]["revision"] == 1) {
        return present;
    }
    for world in present["worlds"].as_array().expect("a list") {
        let name = world["world"].as_str().expect("a name");
        send(client, FULL, "DELETE", &format!("/v1/worlds/{name}"), None).expect(204);
    }
    send(client, FULL, "PUT", "/v1/worlds/a", None).expect(201);
    send(client, FULL, "POST", "/v1/worlds/a/particles", Some("{\"count\":3}")).expect(201);
    worlds(client)
}

fn worlds(client: &mut Client) -> Value {
    send(client, FULL, "GET", "/v1/worlds", None).expect(200).json()
}

/// SIGHUP reads the token file again. Worlds stay, and so does whoever is in.
#[test]
fn tokens_are_rotated_without_a_restart() {
    let [first, second, third] = ["first-of-the-tokens-", "second-of-the-tokens", "third-of-the-tokens-"];
    let file = TokenFile::new("rotated", &format!("{first}\n{second}\n"));
    let mut running = start(Some(&file.0), &[]);
    let address = running.address();
    let mut client = Client::connect(address);
    let mut status = |token: &str| send(&mut client, token, "GET", "/v1/worlds/a/particles/0", None).status;
    send(&mut Client::connect(address), first, "PUT", "/v1/worlds/a", None).expect(201);
    send(&mut Client::connect(address), first, "POST", "/v1/worlds/a/particles", Some("{}")).expect(201);
    assert_eq!([first, second, third].map(&mut status), [200, 200, 401]);

    let mut inside = Client::connect(address);
    let body = "{\"duration\":1}";
    inside.raw(
        format!(
            "POST /v1/worlds/a/advance HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {first}\r\n\
             expect: 100-continue\r\ncontent-length: {}\r\n\r\n",
            body.len()
        )
        .as_bytes(),
    );
    assert_eq!(inside.answer(false).status, 100, "the token was good and the body is waited for");
    file.write(&format!("{second}\n{third}\n"));
    running.signal("HUP");
    running.logged("2 full and 0 read-only");
    assert_eq!([first, second, third].map(&mut status), [401, 200, 200]);
    inside.raw(body.as_bytes());
    assert_eq!(inside.answer(false).expect(200).json()["revision"], 2);

    for text in ["", "# none\n", "read-only\n", "a token\n", "read-only a token\n", "readonly token\n", "tökén\n"] {
        file.write(text);
        running.signal("HUP");
        assert!(running.logged("stay as they were").contains("ERROR"));
        assert_eq!([first, second, third].map(&mut status), [401, 200, 200], "{text:?}");
    }
    std::fs::remove_file(&file.0).expect("ours");
    running.signal("HUP");
    running.logged("cannot read the token file");
    assert_eq!([first, second, third].map(&mut status), [401, 200, 200]);
    file.write(&format!("{third}\nread-only {second}\n"));
    running.signal("HUP");
    running.logged("1 full and 1 read-only");
    assert_eq!([first, second, third].map(&mut status), [401, 200, 200]);
    send(&mut Client::connect(address), second, "DELETE", "/v1/worlds/a", None).expect(403);
    running.signal("TERM");
    assert_eq!(running.end().0, Some(0));
}

/// The signal of a terminal that closes, and with it whoever read the log.
#[test]
fn without_a_token_file_sighup_ends_nothing() {
    let mut running = start(None, &[("POINTMASS_TOKEN", FULL)]);
    let address = running.address();
    running.signal("HUP");
    running.logged("no token file");
    running.close_log();
    running.signal("HUP");
    let mut client = Client::connect(address);
    send(&mut client, FULL, "GET", "/v1", None).expect(200);
    client.get("/v1").expect(401);
    running.signal("TERM");
    assert_eq!(running.end().0, Some(0));
}

#[test]
fn what_is_no_token_is_not_taken_for_one() {
    let file = TokenFile::new("malformed", "");
    for (text, words) in [
        ("", "has no token"),
        ("good-0123456789abcdef\nread-only\n", "line 2"),
        ("\n# a comment\nsecret of three words\n", "line 3"),
        ("readonly secret\n", "line 1"),
        ("\u{feff}secret\n", "line 1"),
    ] {
        file.write(text);
        let error = Tokens::read(&file.0).expect_err(text).to_string();
        assert!(error.contains(words) && !error.contains("secret"), "{text:?}: {error}");
    }
    for (variable, value) in [
        ("POINTMASS_TOKEN", ""),
        ("POINTMASS_TOKEN", "secret of-spaces"),
        ("POINTMASS_TOKEN", "secret,"),
        ("POINTMASS_READ_ONLY_TOKEN", "secr\u{e9}t"),
    ] {
        let (code, out, log) = start(None, &[(variable, value)]).end();
        assert_eq!((code, out.as_str()), (Some(1), ""), "{variable}={value}");
        assert!(log.contains(variable) && !log.contains("secr"), "{log}");
    }
}

#[test]
fn weak_tokens_are_warned_of() {
    let file = TokenFile::new("weak", "0123456789abcde\nread-only 0123456789abcdef\n");
    set_permissions(&file.0, Permissions::from_mode(0o640)).expect("ours");
    let mut running = start(Some(&file.0), &[("POINTMASS_READ_ONLY_TOKEN", "short,0123456789abcdef")]);
    running.address();
    running.signal("TERM");
    let log = running.end().2;
    let warnings: Vec<&str> = log.lines().filter(|line| line.contains("WARN")).collect();
    assert_eq!(warnings.len(), 3, "{log}");
    assert!(warnings[0].contains("POINTMASS_READ_ONLY_TOKEN") && warnings[0].contains("16 characters"), "{log}");
    assert!(warnings[1].contains("others can open the token file") && warnings[1].contains("640"), "{log}");
    assert!(warnings[2].contains("line 1 of the token file"), "{log}");
    file.write("0123456789abcdef\n");
    let mut running = start(Some(&file.0), &[]);
    running.address();
    running.signal("TERM");
    assert!(!running.end().2.contains("WARN"));
}

/// Neither a token that is good nor one that is wrong is written anywhere, nor is a body, at the most talkative level.
#[test]
fn no_token_and_no_body_is_written_down() {
    let file = TokenFile::new("secret", &format!("{FULL}\nread-only {READ_ONLY}\n"));
    let tokens = Tokens::read(&file.0).expect("two tokens");
    let config = Config { token_file: Some(file.0.clone()), tokens, ..Config::default() };
    let mut shown = format!("{:?}", App::new(config).expect("a valid configuration"));
    for format in ["text", "json"] {
        let mut command = command(
            Some(&file.0),
            &[
                ("POINTMASS_TOKEN", VARIABLE),
                ("POINTMASS_READ_ONLY_TOKEN", READ_ONLY_VARIABLE),
                ("POINTMASS_LOG", "trace"),
                ("POINTMASS_LOG_FORMAT", format),
            ],
        );
        // More than a pipe holds.
        let log = temporary("secret.log");
        command.stderr(File::create(&log).expect("a file"));
        let mut running = Running::start(command);
        let address = running.address();
        running.signal("HUP");
        let body = "{\"gravity\":[0.12345678,0,0]}";
        for authorization in [FULL, READ_ONLY, VARIABLE, READ_ONLY_VARIABLE, ROTATED_AWAY]
            .map(bearer)
            .iter()
            .map(String::as_str)
            .chain([FULL, &format!("Basic {FULL}"), &format!("Bearer {READ_ONLY} {FULL}")])
        {
            let headers = [("authorization", authorization)];
            let mut client = Client::connect(address);
            for (method, path, body) in [
                ("GET", "/v1", None),
                ("GET", "/v1/worlds", None),
                ("GET", "/metrics", None),
                ("PUT", "/v1/worlds/a", Some(body)),
                ("PUT", "/v1/worlds/a", Some("{\"gravity\":[0.12345678,0,0]")),
                ("DELETE", "/v1/worlds/a", None),
            ] {
                let answer = client.send(method, path, &headers, body.map(str::as_bytes));
                // A description of a world tells what it was made of.
                if answer.status != 201 {
                    shown += answer.text();
                }
            }
            let mut broken = Client::connect(address);
            broken.raw(format!("GET /v1 HTTP/1.1\r\nauthorization {authorization}\r\n\r\n").as_bytes());
            shown += broken.answer(false).text();
        }
        running.signal("TERM");
        shown += &running.end().1;
        let log = TokenFile(log);
        let log = read_to_string(&log.0).expect("a log");
        assert!(log.contains("DEBUG") && log.contains("read the token file again"), "{log}");
        shown += &log;
    }
    for secret in [FULL, READ_ONLY, VARIABLE, READ_ONLY_VARIABLE, ROTATED_AWAY, "0.12345678"] {
        let at = shown.find(secret).map(|at| &shown[at.saturating_sub(200)..at + secret.len()]);
        assert_eq!(at, None);
    }
}

#[test]
fn pages_of_the_own_and_of_allowed_origins_may_ask() {
    let service = Service::with(|config| {
        config.allow_origin = vec!["https://game.example".to_owned()];
        config.allow_host = vec!["physics.example".to_owned()];
    });
    let mut client = service.client();
    for headers in [
        &[("host", "localhost:8080"), ("origin", "http://localhost:8080")][..],
        &[("host", "localhost:8080"), ("sec-fetch-site", "same-origin")],
        &[("host", "localhost:8080"), ("origin", "https://game.example"), ("sec-fetch-site", "cross-site")],
        &[("host", "physics.example")],
    ] {
        client.send("GET", "/v1", headers, None).expect(200);
    }
    client.send("GET", "/v1", &[("origin", "https://game.example.evil")], None).expect(403);
    let asked = [
        ("origin", "https://game.example"),
        ("access-control-request-method", "PUT"),
        ("access-control-request-headers", "if-match, authorization"),
    ];
    let preflight = client.send("OPTIONS", "/v1/worlds/a", &asked, None);
    assert_eq!(preflight.header("access-control-allow-headers"), Some("if-match, authorization"));
    assert_eq!(preflight.header("access-control-allow-origin"), Some("https://game.example"));
    let answer = client.send("GET", "/v1", &asked[..1], None).expect(200);
    assert_eq!(answer.header("access-control-allow-origin"), Some("https://game.example"));
    let other = client.send("OPTIONS", "/v1", &[("origin", "https://evil.example"), asked[1]], None);
    assert_eq!(other.header("access-control-allow-origin"), None);
}
