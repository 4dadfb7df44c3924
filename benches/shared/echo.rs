//! What the service is compared with: axum and nothing else, in a process of its own. It reads the body of an advance as
//! JSON and answers with it.

use axum::serve::ListenerExt;
use axum::{Json, Router, routing::post};

/// The first argument of that process; the second says how many threads answer.
pub(crate) const CHILD: &str = "--echo";

#[derive(serde::Serialize, serde::Deserialize)]
struct Advance {
    duration: f64,
}

pub(crate) fn serve(arguments: &[String]) {
    let workers = arguments[0].parse().expect("a number");
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(workers).enable_all().build();
    runtime.expect("threads").block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        println!("echo listening on http://{}", listener.local_addr().expect("bound"));
        let listener = listener.tap_io(|stream| stream.set_nodelay(true).expect("a socket"));
        let routes = Router::new().route("/echo", post(|advance: Json<Advance>| async { advance }));
        axum::serve(listener, routes).await.expect("it ends when it is killed");
    });
}
