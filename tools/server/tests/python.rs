//! A client that knows the contract from a table of its own, in another language.

use std::path::Path;
use std::process::Command;

use crate::asking::{options, serve};
use crate::scenes::street;

#[tokio::test(flavor = "multi_thread")]
async fn a_python_client_with_its_own_table_of_the_contract() {
    let python = std::env::var("DECOUPLEGS_PYTHON").unwrap_or_else(|_| "python3".into());
    let has_grpc = Command::new(&python)
        .args(["-c", "import grpc, google.protobuf"])
        .output();
    if !has_grpc.is_ok_and(|output| output.status.success()) {
        println!(
            "skipped: {python} has no grpcio and protobuf; set DECOUPLEGS_PYTHON to one that has"
        );
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let running = serve(&options(vec![street(folder.path())])).await;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/contract_client.py");
    let address = running.address.to_string();
    let run = move || {
        Command::new(python)
            .arg(script)
            .arg(address)
            .output()
            .unwrap()
    };
    let output = tokio::task::spawn_blocking(run).await.unwrap();
    let (said, complained) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{said}{complained}");
    assert!(said.ends_with("all calls were answered\n"), "{said}");
    running.stop().await.unwrap();
}
