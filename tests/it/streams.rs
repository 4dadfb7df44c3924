use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::service::{Client, Service, shared};

/// A world of a mover, a wall and a ball at rest.
fn scene(client: &mut Client, world: &str) {
    client.put(&format!("/v1/worlds/{world}"), "").expect(201);
    let particles = r#"[{"velocity":[1,0,0]},{"inverse_mass":0},{"position":[5,0,0]}]"#;
    client.post(&format!("/v1/worlds/{world}/particles"), particles).expect(201);
}

fn advance(client: &mut Client, world: &str) -> u64 {
    let answer = client.post(&format!("/v1/worlds/{world}/advance"), r#"{"duration":1}"#).expect(200);
    answer.json()["revision"].as_u64().expect("a number")
}

/// The stream of a world, once its head has come.
struct Follower(Client, String);

impl Follower {
    #[track_caller]
    fn of(service: &Service, path: &str, headers: &str) -> Self {
        let mut client = service.client();
        client.raw(format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n{headers}\r\n").as_bytes());
        let head = client.head();
        assert!(head.starts_with("HTTP/1.1 200 OK"), "{head}");
        Self(client, String::new())
    }

    /// The next line that says something; `None` at the end of the stream.
    fn line(&mut self) -> Option<String> {
        loop {
            if let Some((line, rest)) = self.1.split_once('\n') {
                let (line, rest) = (line.to_owned(), rest.to_owned());
                self.1 = rest;
                if !line.is_empty() && !line.starts_with(':') {
                    return Some(line);
                }
                continue;
            }
            self.1.push_str(std::str::from_utf8(&self.0.chunk()?).expect("text"));
        }
    }

    /// The next event with its id or name.
    #[track_caller]
    fn event(&mut self) -> (String, Value) {
        let name = self.line().expect("an event");
        let data = self.line().expect("its data");
        let data = data.strip_prefix("data: ").unwrap_or_else(|| panic!("{data} after {name}"));
        (name, serde_json::from_str(data).expect("JSON"))
    }
}

/// The state first, then what changed, then why there is no more.
#[test]
fn a_follower_is_told_what_changed_until_the_end() {
    let service = shared();
    let mut client = service.client();
    scene(&mut client, "followed");
    let mut events = Follower::of(&service, "/v1/worlds/followed/stream?fields=position&rate=1000", "");
    let mut lines =
        Follower::of(&service, "/v1/worlds/followed/stream?rate=1000&fields=position", "accept: application/jsonl\r\n");
    let first = json!({"time": 0.0, "revision": 1, "full": true, "removed": [], "count": 3, "id": [0, 1, 2],
        "position": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]});
    let moved =
        json!({"time": 1.0, "revision": 2, "removed": [], "count": 1, "id": [0], "position": [[1.0, 0.0, 0.0]]});
    let gone = json!({"time": 1.0, "revision": 3, "removed": [2], "count": 0, "id": [], "position": []});
    for (name, event) in [("id: 1", first), ("id: 2", moved), ("id: 3", gone)] {
        assert_eq!(events.event(), (name.to_owned(), event.clone()));
        assert_eq!(serde_json::from_str::<Value>(&lines.line().expect("a line")).expect("JSON"), event);
        match name {
            "id: 1" => _ = advance(&mut client, "followed"),
            "id: 2" => _ = client.delete("/v1/worlds/followed/particles/2").expect(204),
            _ => _ = client.delete("/v1/worlds/followed").expect(204),
        }
    }
    let (name, problem) = events.event();
    assert_eq!((name.as_str(), problem["code"].as_str()), ("event: end", Some("unknown_world")));
    assert_eq!(events.line(), None, "the stream is over");
    let end: Value = serde_json::from_str(&lines.line().expect("the end")).expect("JSON");
    assert_eq!(end["end"], problem);
    assert_eq!(lines.line(), None);
}

/// Of many changes a follower sees the newest, in their order, and no more often than it asked.
#[test]
fn a_follower_is_told_at_its_rate() {
    let service = shared();
    let mut client = service.client();
    scene(&mut client, "paced");
    let mut events = Follower::of(&service, "/v1/worlds/paced/stream?fields=position&rate=20&ids=0,1", "");
    let began = Instant::now();
    let last = (0..400).map(|_| advance(&mut client, "paced")).last().expect("many");
    let mut seen = Vec::new();
    while seen.last() != Some(&last) {
        let (_, event) = events.event();
        let (revision, count) = (event["revision"].as_u64().expect("a number"), event["count"].as_u64());
        // Revision 1 is the creation; each advance moves the first particle by 1.
        assert_eq!(event["position"][0][0], (revision - 1) as f64, "{event}");
        assert_eq!(count, Some(if seen.is_empty() { 2 } else { 1 }));
        seen.push(revision);
    }
    let most = 2 + began.elapsed().as_millis() / 50;
    assert!(seen.is_sorted_by(|a, b| a < b) && seen.len() as u128 <= most, "{} events, {most} at most", seen.len());
}

/// Who does not read has nothing queued up: afterwards it is told the newest state.
#[test]
fn a_slow_follower_gets_the_newest_state() {
    let service = Service::start();
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    client.post("/v1/worlds/a/particles", r#"{"count":20000,"velocity":[0.1,0.2,0.3]}"#).expect(201);
    let mut events = Follower::of(&service, "/v1/worlds/a/stream?rate=1000", "");
    let (_, first) = events.event();
    assert_eq!(first["count"], 20_000);
    // Some of what follows is with the system, some with the service, and the rest is never made.
    let last = (0..300).map(|_| advance(&mut client, "a")).last().expect("many");
    std::thread::sleep(Duration::from_millis(300));
    let charged = client.get("/metrics");
    let charged = charged.text().lines().find_map(|line| line.strip_prefix("pointmass_in_flight_charged_bytes "));
    let charged: u64 = charged.expect("a number").parse().expect("a number");
    assert!(charged < 4 << 20, "{charged} bytes are held");
    let mut seen = Vec::new();
    while seen.last() != Some(&last) {
        seen.push(events.event().1["revision"].as_u64().expect("a number"));
    }
    assert!(seen.is_sorted_by(|a, b| a < b) && seen.len() < 30, "{} of 300 events", seen.len());
}

/// Who comes back is told what it missed, or everything when that is not known any more.
#[test]
fn a_follower_resumes() {
    let service = shared();
    let mut client = service.client();
    scene(&mut client, "resumed");
    let path = "/v1/worlds/resumed/stream?fields=position";
    let mut events = Follower::of(&service, path, "");
    let (_, first) = events.event();
    drop(events);
    let known = first["revision"].as_u64().expect("a number");
    advance(&mut client, "resumed");
    client.delete("/v1/worlds/resumed/particles/1").expect(204);
    let missed = json!({"time": 1.0, "revision": known + 2, "removed": [1], "count": 1, "id": [0],
        "position": [[1.0, 0.0, 0.0]]});
    let (_, event) = Follower::of(&service, &format!("{path}&since={known}"), "").event();
    assert_eq!(event, missed);
    let (_, event) = Follower::of(&service, path, &format!("last-event-id: {known}\r\n")).event();
    assert_eq!(event, missed);
    for unknown in [0, 1000] {
        let (_, event) = Follower::of(&service, &format!("{path}&since={unknown}"), "").event();
        assert_eq!((&event["full"], &event["count"]), (&json!(true), &json!(2)), "{unknown}");
    }
}

#[test]
fn what_cannot_be_followed_is_refused() {
    let service = shared();
    let mut client = service.client();
    scene(&mut client, "refused-stream");
    let path = "/v1/worlds/refused-stream/stream";
    for (query, status, code) in [
        ("?rate=0", 422, "invalid_parameter"),
        ("?rate=-1", 422, "invalid_parameter"),
        ("?rate=NaN", 422, "invalid_parameter"),
        ("?rate=1001", 422, "invalid_parameter"),
        ("?ids=0,x", 422, "invalid_parameter"),
        ("?fields=colour", 422, "invalid_parameter"),
        ("?since=-1", 422, "invalid_parameter"),
        ("?encoding=cbor", 422, "invalid_parameter"),
        ("?more=1", 422, "invalid_parameter"),
        ("?ids=0,7", 404, "unknown_particle"),
    ] {
        assert_eq!(client.get(&format!("{path}{query}")).expect(status).json()["code"], code, "{query}");
    }
    client.get("/v1/worlds/nowhere/stream").expect(404);
    client.send("GET", path, &[("accept", "image/png")], None).expect(406);
    client.post(path, "{}").expect(405);
    let half = [("upgrade", "websocket"), ("connection", "upgrade")];
    assert_eq!(client.send("GET", path, &half, None).expect(400).json()["code"], "malformed_request");
}

/// Followers do not keep a service from ending, and are told why.
#[test]
fn followers_are_told_that_the_service_ends() {
    let service = Service::start();
    let mut client = service.client();
    scene(&mut client, "a");
    let mut events = Follower::of(&service, "/v1/worlds/a/stream", "");
    let mut socket = Socket::of(&service, "/v1/worlds/a/stream", "");
    events.event();
    socket.json();
    let began = Instant::now();
    drop(client);
    let ending = std::thread::spawn(move || drop(service));
    let (name, problem) = events.event();
    assert_eq!((name.as_str(), problem["code"].as_str()), ("event: end", Some("shutting_down")));
    assert_eq!(socket.closed(), (1001, "shutting_down".to_owned()));
    ending.join().expect("it ends");
    assert!(began.elapsed() < Duration::from_secs(20));
}

/// A WebSocket by the letter of RFC 6455.
struct Socket(Client);

impl Socket {
    #[track_caller]
    fn of(service: &Service, path: &str, headers: &str) -> Self {
        let mut client = service.client();
        let head = format!(
            "GET {path} HTTP/1.1\r\nhost: localhost\r\nupgrade: websocket\r\nconnection: Upgrade\r\n\
             sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n{headers}\r\n"
        );
        client.raw(head.as_bytes());
        let head = client.head();
        assert!(head.starts_with("HTTP/1.1 101"), "{head}");
        // The answer to this key in the RFC.
        assert!(head.contains("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="), "{head}");
        Self(client)
    }

    /// One frame, masked as those of clients are.
    fn send(&mut self, opcode: u8, payload: &[u8]) {
        let mask = [0x12, 0x34, 0x56, 0x78];
        let length = u16::try_from(payload.len()).expect("a short frame").to_be_bytes();
        let mut frame = vec![0x80 | opcode, 0x80 | 0x7e, length[0], length[1]];
        frame.extend_from_slice(&mask);
        frame.extend(payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
        self.0.raw(&frame);
    }

    fn frame(&mut self) -> (u8, Vec<u8>) {
        let head = self.0.bytes(2);
        assert!(head[0] & 0x80 != 0 && head[1] & 0x80 == 0, "one frame, not masked");
        let length = match head[1] {
            126 => self.0.bytes(2),
            127 => self.0.bytes(8),
            short => vec![short],
        };
        let length = length.iter().fold(0, |length, byte| length << 8 | usize::from(*byte));
        (head[0] & 15, self.0.bytes(length))
    }

    #[track_caller]
    fn json(&mut self) -> Value {
        let (opcode, text) = self.frame();
        assert_eq!(opcode, 1, "text");
        serde_json::from_slice(&text).expect("JSON")
    }

    /// Why it was closed.
    #[track_caller]
    fn closed(&mut self) -> (u16, String) {
        let (opcode, reason) = self.frame();
        assert_eq!(opcode, 8, "the end");
        (u16::from_be_bytes([reason[0], reason[1]]), String::from_utf8_lossy(&reason[2..]).into_owned())
    }
}

/// Over a WebSocket commands go up and answers come down, between what changed.
#[test]
fn a_socket_takes_commands_and_tells_changes() {
    let service = shared();
    let mut client = service.client();
    scene(&mut client, "talked");
    let mut socket = Socket::of(&service, "/v1/worlds/talked/stream?fields=position&rate=1000", "");
    assert_eq!(socket.json()["full"], true);
    socket.send(1, br#"{"commands":[{"impulse":{"ids":[2],"impulse":[0,1,0]}},{"advance":{"duration":2}}]}"#);
    let (mut answer, mut event) = (socket.json(), socket.json());
    if answer.get("results").is_none() {
        std::mem::swap(&mut answer, &mut event);
    }
    assert_eq!((&answer["revision"], &answer["results"][0]), (&json!(2), &json!({"count": 1})));
    assert_eq!(event["id"], json!([0, 2]));
    assert_eq!(event["position"], json!([[2.0, 0.0, 0.0], [5.0, 2.0, 0.0]]));
    // What is refused is answered too, and changes nothing.
    for (frame, code, pointer) in [
        (
            &br#"{"commands":[{"advance":{"duration":-1}}]}"#[..],
            "duration_not_positive",
            Some("/commands/0/advance/duration"),
        ),
        (br#"{"commands":["#, "malformed_json", None),
        (br#"{"command":1}"#, "unknown_field", Some("/command")),
    ] {
        socket.send(1, frame);
        let refused = socket.json();
        assert_eq!((refused["code"].as_str(), refused["pointer"].as_str()), (Some(code), pointer), "{refused}");
    }
    // {"commands": [{"advance": {"duration": 0.5}}]} in CBOR, answered in CBOR.
    let cbor = b"\xa1\x68commands\x81\xa1\x67advance\xa1\x68duration\xfb\x3f\xe0\0\0\0\0\0\0";
    socket.send(2, cbor);
    let opcodes = [socket.frame().0, socket.frame().0];
    assert!(opcodes == [1, 2] || opcodes == [2, 1], "{opcodes:?}");
    // A ping is answered.
    socket.send(9, b"hi");
    assert_eq!(socket.frame(), (10, b"hi".to_vec()));
    let mut binary = Socket::of(&service, "/v1/worlds/talked/stream?encoding=cbor&fields=mass", "");
    let (opcode, event) = binary.frame();
    assert_eq!((opcode, event[0]), (2, 0xa7), "a map of seven in CBOR");
    client.delete("/v1/worlds/talked").expect(204);
    assert_eq!(socket.closed(), (1000, "unknown_world".to_owned()));
    assert_eq!(binary.closed(), (1000, "unknown_world".to_owned()));
}

/// What comes up is a body: no larger than one may be.
#[test]
fn a_frame_is_no_larger_than_a_body() {
    let service = Service::with(|config| config.body_bytes_max = 100);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    let mut socket = Socket::of(&service, "/v1/worlds/a/stream", "");
    assert_eq!(socket.json()["count"], 0);
    let commands = |length| format!("{:<length$}", r#"{"commands":[]}"#);
    socket.send(1, commands(100).as_bytes());
    assert_eq!(socket.json(), json!({"results": [], "revision": 0}));
    socket.send(1, commands(101).as_bytes());
    assert!(socket.0.is_gone());
}

/// Reading is not changing, whichever way the commands come.
#[test]
fn a_read_only_token_follows_and_commands_nothing() {
    let file = std::env::temp_dir().join(format!("pointmass-stream-tokens-{}", std::process::id()));
    std::fs::write(&file, "full-token-0123456789\nread-only seen-token-0123456789\n").expect("a file");
    let service = Service::with(|config| config.token_file = Some(file.clone()));
    let mut client = service.client();
    let full = [("authorization", "Bearer full-token-0123456789")];
    client.send("PUT", "/v1/worlds/a", &full, Some(b"")).expect(201);
    let commands = br#"{"commands":[{"create":{}}]}"#;
    for (token, created) in [("seen-token-0123456789", false), ("full-token-0123456789", true)] {
        let header = format!("authorization: Bearer {token}\r\n");
        let mut socket = Socket::of(&service, "/v1/worlds/a/stream", &header);
        assert_eq!(socket.json()["count"], 0);
        socket.send(1, commands);
        let answers = [socket.json()];
        let refused = answers.iter().any(|answer| answer["code"] == "read_only_token");
        assert_eq!(refused, !created, "{answers:?}");
    }
    std::fs::remove_file(file).expect("it is there");
}
