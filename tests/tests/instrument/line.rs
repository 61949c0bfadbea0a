//! The host sets its port as the boards set their UARTs. A pseudo-terminal carries bytes at any speed, so that no other test
//! can see a difference: what the host left on one is read back here.

use std::fs::OpenOptions;

use flankscope_instrument::controller::Link;
use flankscope_protocol::{FlowControl, Line, LineRecord, Parity};
use flankscope_test_requisites::{board_image, workspace};
use flankscope_tests::pseudo_terminal;
use rustix::termios::{ControlModes, InputModes, tcgetattr};

/// The settings that the host leaves on a port, as the kernel has them (`TCGETS2`).
fn host_line() -> [u8; 8] {
    let (_master, path) = pseudo_terminal();
    let slave = OpenOptions::new()
        .read(true)
        .write(true)
        .open(&path)
        .unwrap();
    let before = tcgetattr(&slave).unwrap().output_speed();
    let _link = Link::open(&path).unwrap();
    let set = tcgetattr(&slave).unwrap();
    assert_ne!(before, set.output_speed(), "the host has set its port");
    assert_eq!(set.input_speed(), set.output_speed());
    assert!(
        !set.input_modes
            .intersects(InputModes::IXON | InputModes::IXOFF),
        "no byte of a message stops the line"
    );
    let modes = set.control_modes;
    let bits = |of: ControlModes| match modes & ControlModes::CSIZE {
        size if size == of => 8,
        size if size == ControlModes::CS7 => 7,
        size => panic!("{size:?}"),
    };
    let line = Line {
        baud: set.output_speed(),
        data_bits: bits(ControlModes::CS8),
        // The kernel lets no pseudo-terminal have parity: this tells of an even worse mistake only.
        parity: match (
            modes.contains(ControlModes::PARENB),
            modes.contains(ControlModes::PARODD),
        ) {
            (false, _) => Parity::None,
            (true, false) => Parity::Even,
            (true, true) => Parity::Odd,
        },
        stop_bits: 1 + u8::from(modes.contains(ControlModes::CSTOPB)),
        flow: match modes.contains(ControlModes::CRTSCTS) {
            false => FlowControl::None,
            true => FlowControl::RtsCts,
        },
    };
    line.bytes()
}

#[test]
fn the_host_sets_its_port_as_the_protocol_has_it() {
    assert_eq!(host_line(), Line::HOST.bytes());
}

/// The images configure their UARTs from the record that is found in them.
#[test]
fn the_boards_set_their_uarts_as_the_host_sets_its_port() {
    let host = host_line();
    for board in ["mps2-an386", "nucleo-h743zi", "netduinoplus2-f405"] {
        let Some(image) = board_image(board) else {
            continue;
        };
        let image = std::fs::read(image).unwrap();
        let lines: Vec<[u8; 8]> = LineRecord::find(&image).collect();
        assert_eq!(lines, [host], "{board}");
    }
}

#[test]
fn the_readme_tells_the_line() {
    let path = workspace().join("firmware/README.md");
    let readme = std::fs::read_to_string(path).unwrap();
    let row = |row: &&str| row.starts_with("| host link |");
    let row = readme.lines().find(row).unwrap();
    assert!(row.contains(&Line::HOST.to_string()), "{row}");
    let flashing = format!("serial port ({})", Line::HOST);
    assert!(readme.contains(&flashing), "{flashing}");
}
