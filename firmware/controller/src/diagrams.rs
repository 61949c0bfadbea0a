//! The state diagrams of `firmware/README.md`: the tests that own the state machines draw them, so that they cannot lie.
//!
//! `FLANKSCOPE_DRAW=1 cargo test -p flankscope-controller drawn` draws them anew.

extern crate std;

use std::collections::{BTreeMap, BTreeSet};
use std::format;
use std::string::String;
use std::sync::Mutex;

/// Changes of state, each with what causes it.
pub type Changes = BTreeMap<(String, String), BTreeSet<String>>;

/// Both diagrams are in one file.
static FILE: Mutex<()> = Mutex::new(());

/// The diagram as Mermaid. Changes that every state of `group` has alike are drawn once.
pub fn mermaid(first: &str, group: (&str, &[&str]), changes: &Changes) -> String {
    let (name, members) = group;
    let inside = |state: &str| members.contains(&state);
    let mut alike: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for ((from, to), causes) in changes {
        if inside(from) && !inside(to) {
            let common: BTreeSet<String> = causes
                .iter()
                .filter(|cause| {
                    members.iter().all(|member| {
                        let change = (String::from(*member), to.clone());
                        changes.get(&change).is_some_and(|all| all.contains(*cause))
                    })
                })
                .cloned()
                .collect();
            if !common.is_empty() {
                alike.insert(to, common);
            }
        }
    }
    let line = |from: &str, to: &str, causes: &BTreeSet<String>| {
        let causes: std::vec::Vec<&str> = causes
            .iter()
            .map(String::as_str)
            .filter(|cause| !cause.is_empty())
            .collect();
        if causes.is_empty() {
            format!("{from} --> {to}\n")
        } else {
            format!("{from} --> {to}: {}\n", causes.join(", "))
        }
    };
    let mut text = format!("```mermaid\nstateDiagram-v2\n    [*] --> {first}\n");
    if !members.is_empty() {
        text += &format!("    state {name} {{\n");
        for ((from, to), causes) in changes {
            if inside(from) && inside(to) {
                text += &format!("        {}", line(from, to, causes));
            }
        }
        text += "    }\n";
    }
    for (to, causes) in &alike {
        text += &format!("    {}", line(name, to, causes));
    }
    for ((from, to), causes) in changes {
        if inside(from) && inside(to) {
            continue;
        }
        let own: BTreeSet<String> = match alike.get(to.as_str()).filter(|_| inside(from)) {
            Some(common) => causes.difference(common).cloned().collect(),
            None => causes.clone(),
        };
        if !own.is_empty() {
            text += &format!("    {}", line(from, to, &own));
        }
    }
    text + "```\n"
}

/// Fails unless the README has this diagram between its marks.
pub fn assert_drawn(name: &str, diagram: &str) {
    let _alone = FILE.lock();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../README.md");
    let readme = std::fs::read_to_string(path).expect("firmware/README.md");
    let (begin, end) = (format!("<!-- drawn: {name} -->\n"), "<!-- end -->\n");
    let (before, rest) = readme.split_once(&begin).expect("the mark");
    let (drawn, after) = rest.split_once(end).expect("the end mark");
    if std::env::var_os("FLANKSCOPE_DRAW").is_some() {
        let text = format!("{before}{begin}{diagram}{end}{after}");
        std::fs::write(path, text).expect("written");
    } else {
        assert_eq!(
            drawn, diagram,
            "the state machine has changed; draw it anew: \
             FLANKSCOPE_DRAW=1 cargo test -p flankscope-controller drawn"
        );
    }
}
