//! Controls a page in headless Chromium through the Chrome DevTools Protocol over two pipes.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

/// Time limit of each wait. It is longer than any page needs, and it ends the test if the browser hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// A browser with one page.
pub struct Browser {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    session: String,
    last_id: u64,
    /// All events received so far, oldest first.
    pub events: Vec<Value>,
    _profile: TempDir,
}

impl Browser {
    /// Starts `chromium`, or the program in PARFOCAL_CHROMIUM, with software WebGL. A missing browser fails the test.
    pub fn start(width: u32, height: u32) -> Self {
        let program = std::env::var("PARFOCAL_CHROMIUM").unwrap_or_else(|_| "chromium".to_string());
        let profile = TempDir::new().unwrap();
        // The protocol uses file descriptors 3 and 4. `timeout` ends the browser if this process is killed.
        let mut child = Command::new("sh")
            .args(["-c", r#"exec timeout 600 "$0" "$@" 3<&0 4>&1 </dev/null >/dev/null"#, &program])
            .args(["--headless", "--no-sandbox", "--disable-gpu-sandbox", "--disable-dev-shm-usage", "--no-first-run"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-pipe"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg(format!("--window-size={width},{height}"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let (to, from) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let mut browser =
            Self { child, to, from, session: String::new(), last_id: 0, events: Vec::new(), _profile: profile };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        browser.session = browser.call("Target.attachToTarget", attach)["sessionId"].as_str().unwrap().to_string();
        browser.call("Page.bringToFront", json!({}));
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", metrics);
        browser
    }

    /// Sends one command and waits for its answer.
    #[track_caller]
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.answer(method, parameters).unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// Sends one command and waits for its answer, which may be an error.
    #[track_caller]
    fn answer(&mut self, method: &str, parameters: Value) -> Result<Value, Value> {
        self.last_id += 1;
        let mut message = json!({ "id": self.last_id, "method": method, "params": parameters });
        if !self.session.is_empty() {
            message["sessionId"] = self.session.as_str().into();
        }
        self.to.write_all(format!("{message}\0").as_bytes()).expect("the browser is missing: run tools/setup --test");
        loop {
            let message = self.receive();
            if message["id"] == self.last_id {
                let [error, result] = ["error", "result"].map(|part| message[part].clone());
                return if error.is_null() { Ok(result) } else { Err(error) };
            }
            self.events.push(message);
        }
    }

    #[track_caller]
    fn receive(&mut self) -> Value {
        let mut bytes = Vec::new();
        self.from.read_until(0, &mut bytes).unwrap();
        assert_eq!(
            bytes.pop(),
            Some(0),
            "no browser, or it has ended: run tools/setup --test, or set PARFOCAL_CHROMIUM"
        );
        serde_json::from_slice(&bytes).unwrap()
    }

    /// Opens a file and waits until a JavaScript expression is true in the page.
    #[track_caller]
    pub fn open(&mut self, file: &Path, ready: &str) {
        self.call("Page.navigate", json!({ "url": format!("file://{}", file.display()) }));
        self.wait(ready);
    }

    /// Waits until a JavaScript expression is true in the page.
    #[track_caller]
    pub fn wait(&mut self, ready: &str) {
        let start = Instant::now();
        let request = json!({ "expression": format!("Boolean({ready})"), "returnByValue": true });
        // An error: the page is being left for the next one.
        while !self.answer("Runtime.evaluate", request.clone()).is_ok_and(|answer| answer["result"]["value"] == true) {
            assert!(start.elapsed() < PATIENCE, "the page is not ready: {:#?}", self.complaints());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Evaluates a JavaScript expression and returns its value. A promise is awaited.
    #[track_caller]
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let request = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.call("Runtime.evaluate", request);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].clone()
    }

    /// Moves the mouse along points of the window, in px. `pressed` holds the left button down.
    pub fn mouse(&mut self, points: &[[f64; 2]], pressed: bool) {
        let mut send = |kind: &str, [x, y]: [f64; 2], buttons: u32| {
            let button = if buttons == 1 || kind == "mouseReleased" { "left" } else { "none" };
            let event = json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", event);
        };
        let (first, last) = (points[0], points[points.len() - 1]);
        send("mouseMoved", first, 0);
        if pressed {
            send("mousePressed", first, 1);
        }
        points.iter().for_each(|&point| send("mouseMoved", point, u32::from(pressed)));
        if pressed {
            send("mouseReleased", last, 0);
        }
    }

    /// Console messages other than logs, exceptions, failed loads and network requests of the page.
    pub fn complaints(&self) -> Vec<String> {
        let bad = |event: &&Value| match event["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" | "Network.loadingFailed" => true,
            "Runtime.consoleAPICalled" => event["params"]["type"] != "log",
            "Log.entryAdded" => event["params"]["entry"]["level"] != "verbose",
            "Network.requestWillBeSent" => {
                let url = event["params"]["request"]["url"].as_str().unwrap_or_default();
                !["file:", "data:", "blob:"].iter().any(|scheme| url.starts_with(scheme))
            }
            _ => false,
        };
        self.events.iter().filter(bad).map(Value::to_string).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // `timeout` forwards the signal. Closing the pipes also ends the browser.
        let _ = self.to.write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        let _ = self.child.wait();
    }
}
