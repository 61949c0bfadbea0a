//! No circle between the floors of a crate: the modules right below its root form a graph by what they import, and that
//! graph has a direction.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Which floors a floor imports.
type Floors = BTreeMap<String, BTreeSet<String>>;

/// Fails when a crate has a circle between its floors, and names one circle of every such crate.
pub fn check(root: &Path, crates: &[String]) -> Result<(), String> {
    let (mut found, mut checked) = (Vec::new(), 0);
    for of in crates {
        let source = root.join(of).join("src");
        if !source.is_dir() {
            continue; // tests alone
        }
        let floors = floors(&source)?;
        checked += floors.len();
        if let Some(circle) = circle(&floors) {
            found.push(format!(
                "{of}: its modules import each other in a circle: {}; move what they share below both",
                circle.join(" -> ")
            ));
        }
    }
    if found.is_empty() {
        eprintln!("floors: {checked} in {} crates, no circle", crates.len());
        return Ok(());
    }
    Err(found.join("\n"))
}

fn floors(source: &Path) -> Result<Floors, String> {
    let mut texts = BTreeMap::new();
    for entry in entries(source)? {
        let name = entry.file_stem().unwrap_or_default().to_string_lossy();
        if name != "lib" && name != "main" {
            collect(&entry, 1, texts.entry(name.into_owned()).or_default())?;
        }
    }
    let names: BTreeSet<String> = texts.keys().cloned().collect();
    let imports = |(floor, text): (String, String)| {
        let mut imported = imports(&text, &names);
        imported.remove(&floor);
        (floor, imported)
    };
    Ok(texts.into_iter().map(imports).collect())
}

fn entries(folder: &Path) -> Result<Vec<std::path::PathBuf>, String> {
    let failed = |error| format!("{}: {error}", folder.display());
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    entries
        .map(|entry| entry.map(|entry| entry.path()).map_err(failed))
        .collect()
}

/// Appends the code of a file, or of all files below a folder, `depth` modules below the crate's root. A file's tests come last
/// and may look anywhere.
fn collect(path: &Path, depth: usize, into: &mut String) -> Result<(), String> {
    if path.is_dir() {
        return entries(path)?.iter().try_for_each(|entry| {
            let inside = usize::from(entry.file_name().is_some_and(|name| name != "mod.rs"));
            collect(entry, depth + inside, into)
        });
    }
    if path.extension().is_none_or(|of| of != "rs") {
        return Ok(());
    }
    let text =
        std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let code = text.split("#[cfg(test)]\nmod tests").next();
    for line in code.unwrap_or_default().lines() {
        let code = line.split("//").next().unwrap_or_default();
        into.push_str(&from_root(code, depth));
        into.push('\n');
    }
    Ok(())
}

/// A line of a module so deep below the root, in which what begins at the root by `super::` begins by `crate::`.
fn from_root(line: &str, depth: usize) -> String {
    line.replace(&"super::".repeat(depth), "crate::")
}

/// The floors that a text names: as `crate::floor`, or in a list, `crate::{floor::Item, other}`.
fn imports(text: &str, names: &BTreeSet<String>) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for rest in text.split("crate::").skip(1) {
        let listed = rest.strip_prefix('{').map(|list| {
            let mut depth = 0;
            let end = list.find(|c| {
                depth += i32::from(c == '{') - i32::from(c == '}');
                depth < 0
            });
            &list[..end.unwrap_or(list.len())]
        });
        // Of a list the words at its own depth count, not those in the lists inside it.
        let mut depth = 0;
        let heads = listed.unwrap_or(rest).split(|c| {
            depth += i32::from(c == '{') - i32::from(c == '}');
            depth == 0 && c == ','
        });
        for head in heads.take(if listed.is_some() { usize::MAX } else { 1 }) {
            let word: String = head
                .trim_start()
                .chars()
                .take_while(|c| c.is_alphanumeric() || *c == '_')
                .collect();
            if names.contains(&word) {
                found.insert(word);
            }
        }
    }
    found
}

/// A walk from a floor back to itself, if there is one.
fn circle(floors: &Floors) -> Option<Vec<String>> {
    let mut done = BTreeSet::new();
    floors
        .keys()
        .find_map(|floor| walk(floor, floors, &mut Vec::new(), &mut done))
}

fn walk(
    floor: &str,
    floors: &Floors,
    way: &mut Vec<String>,
    done: &mut BTreeSet<String>,
) -> Option<Vec<String>> {
    if let Some(begin) = way.iter().position(|passed| passed == floor) {
        let mut circle = way[begin..].to_vec();
        circle.push(floor.to_string());
        return Some(circle);
    }
    if done.contains(floor) {
        return None;
    }
    way.push(floor.to_string());
    let found = floors
        .get(floor)?
        .iter()
        .find_map(|next| walk(next, floors, way, done));
    way.pop();
    done.insert(floor.to_string());
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floors_of(texts: &[(&str, &str)]) -> Floors {
        let names = texts.iter().map(|(name, _)| (*name).to_string()).collect();
        let floor = |(name, text): &(&str, &str)| ((*name).to_string(), imports(text, &names));
        texts.iter().map(floor).collect()
    }

    #[test]
    fn imports_are_found_however_they_are_written() {
        let floors = floors_of(&[
            (
                "top",
                "use crate::{\n    middle::{Item, low, more},\n    other as o,\n};",
            ),
            ("middle", "fn f() -> crate::low::T { g::<crate::Low>() }"),
            ("low", ""),
            ("other", "use crate::lower::X;"),
        ]);
        let of = |floor: &str| -> Vec<&str> { floors[floor].iter().map(String::as_str).collect() };
        assert_eq!(of("top"), ["middle", "other"]);
        assert_eq!(of("middle"), ["low"]);
        assert!(of("low").is_empty() && of("other").is_empty());
        assert_eq!(circle(&floors), None);
        let inside = from_root("use super::super::low::T; use super::other::T;", 2);
        let floors = floors_of(&[("top", &inside), ("low", ""), ("other", "")]);
        assert_eq!(floors["top"], BTreeSet::from(["low".into()]));
    }

    #[test]
    fn a_circle_is_named_however_long() {
        let floors = floors_of(&[
            ("a", "use crate::b::B;"),
            ("b", "use crate::c::C; use crate::d::D;"),
            ("c", ""),
            ("d", "use crate::b::B;"),
        ]);
        assert_eq!(circle(&floors).unwrap(), ["b", "d", "b"]);
    }
}
