//! What the tests need beyond Rust and a C compiler, and how to get it.

use std::path::Path;

use flankscope_test_requisites::{
    BROWSERS, DFQ_READER, MOSQUITTO, MQTT_CLIENTS, OPCUA_CLIENTS, PROMETHEUS, STAGE_CLIENTS,
    has_aravis, on_path,
};

use crate::{firmware, python};

/// Something a group of tests needs and this machine lacks.
#[derive(Clone, Copy)]
pub struct Missing {
    /// The tests that cannot run.
    pub what: &'static str,
    /// What they need.
    pub needs: &'static str,
    /// How to get it.
    pub how: &'static str,
}

/// Environments of Python with other people's packages: `needs` is the interpreter, below the repository.
const ENVIRONMENTS: [Missing; 4] = [
    Missing {
        what: "the emulated stage controller driven by other people's clients (PyMeasure, InstrumentKit)",
        needs: STAGE_CLIENTS,
        how: "python3 -m venv target/stage-clients && target/stage-clients/bin/pip install --no-deps -r tools/peers/stage-clients.txt",
    },
    Missing {
        what: "the plant's messages read by other people's MQTT and Sparkplug B clients (paho, pysparkplug)",
        needs: MQTT_CLIENTS,
        how: "python3 -m venv target/mqtt-clients && target/mqtt-clients/bin/pip install --no-deps -r tools/peers/mqtt-clients.txt",
    },
    Missing {
        what: "the plant's OPC UA server asked by another's client (asyncua)",
        needs: OPCUA_CLIENTS,
        how: "python3 -m venv target/opcua-clients && target/opcua-clients/bin/pip install --no-deps -r tools/peers/opcua-clients.txt",
    },
    Missing {
        what: "the plant's DFQ files read by another's reader (aqdefreader)",
        needs: DFQ_READER,
        how: "python3 -m venv target/dfq-reader && target/dfq-reader/bin/pip install --no-deps -r tools/peers/dfq-reader.txt",
    },
];

/// Everything missing on this machine.
pub fn missing(root: &Path) -> Vec<Missing> {
    let mut missing = Vec::new();
    if !root.join("../shared/data").is_dir() {
        missing.push(Missing {
            what: "tests on other people's data (real fringe images, a CAD gear)",
            needs: "the folder ../shared/data beside the repository",
            how: "place it there: fringe-skull is example data of jakobwilm/slstudio, cad-ring84 was exported with cq_gears",
        });
    }
    if !root.join("../shared/outside").is_dir() {
        missing.push(Missing {
            what: "checks of frames that an outside renderer made",
            needs: "the folder ../shared/outside beside the repository",
            how: "place it there: the demo die rendered by Mitsuba 3, sprayed and of ground steel (its README says how)",
        });
    }
    if !Path::new("/dev/shm").is_dir() {
        missing.push(Missing {
            what: "tests of the zero-copy frame path",
            needs: "POSIX shared memory at /dev/shm",
            how: "mount -t tmpfs tmpfs /dev/shm",
        });
    }
    let images = [firmware::EMULATED_IMAGE, firmware::EMULATED_STM32_IMAGE];
    let images = images.iter().all(|image| root.join(image).is_file());
    if on_path("qemu-system-arm").is_none() || !images {
        missing.push(Missing {
            what: "the check through the controller's Cortex-M image, and the board's program on an emulated STM32",
            needs: "qemu-system-arm and the images",
            how: "apt-get update && apt-get install qemu-system-arm rustc-web cargo-web rust-web-src lld, then cargo xtask firmware",
        });
    }
    if !BROWSERS.iter().any(|name| on_path(name).is_some()) {
        missing.push(Missing {
            what: "pages drawn at three widths and printed",
            needs: "Chromium",
            how: "apt-get install chromium",
        });
    }
    if !has_aravis() {
        missing.push(Missing {
            what: "the check with every frame through a GigE Vision camera",
            needs: "Aravis 0.8.20 or newer, with its headers",
            how: "apt-get install libaravis-dev libusb-1.0-0-dev pkg-config",
        });
    }
    if !python::is_there() {
        missing.push(Missing {
            what: "the Python package (host/python), in --all",
            needs: "Python with venv and pip, and PyPI",
            how: "apt-get install python3-venv",
        });
    }
    if !Path::new(MOSQUITTO).is_file() || on_path("openssl").is_none() {
        missing.push(Missing {
            what: "the plant's messages to another's MQTT broker",
            needs: "mosquitto, and openssl for its certificates",
            how: "apt-get install mosquitto openssl",
        });
    }
    if on_path(PROMETHEUS).is_none() {
        missing.push(Missing {
            what: "the plant's metrics scraped by another's server, and every panel of the dashboard asked of it",
            needs: "Prometheus",
            how: "apt-get install --no-install-recommends prometheus",
        });
    }
    let environments = ENVIRONMENTS.iter().copied();
    missing.extend(environments.filter(|of| !root.join(of.needs).is_file()));
    missing
}
