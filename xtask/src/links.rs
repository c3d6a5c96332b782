//! References between documents and sources: relative links of Markdown files, files that they name in backticks, and documents
//! that sources cite must exist, with their headings.

use std::{fs, path::Path};

use crate::process::{Outcome, command, root};

/// Checks all files under version control and new ones.
pub fn check() -> Outcome {
    eprintln!("\n==> links between documents and sources");
    let mut git = command("git");
    git.args(["ls-files", "--cached", "--others", "--exclude-standard"]);
    let listed = git.output().map_err(|error| format!("cannot run git: {error}"))?;
    let listed = String::from_utf8_lossy(&listed.stdout);
    let files: Vec<&str> = listed.lines().filter(|name| root().join(name).is_file()).collect();
    let mut broken = Vec::new();
    for name in &files {
        let (markdown, source) = (name.ends_with(".md"), SOURCES.iter().any(|ending| name.ends_with(ending)));
        if !markdown && !source {
            continue;
        }
        let path = root().join(name);
        let text = fs::read_to_string(&path).map_err(|error| format!("cannot read {name}: {error}"))?;
        if markdown {
            let folder = path.parent().unwrap_or(root());
            broken.extend(
                links(&text).into_iter().filter(|link| !leads(folder, &path, link)).map(|l| (name, l)),
            );
            broken.extend(named(&text).into_iter().filter(|file| !exists(&files, file)).map(|f| (name, f)));
        } else {
            broken
                .extend(citations(&text).into_iter().filter(|c| !leads(root(), &path, c)).map(|c| (name, c)));
        }
    }
    if broken.is_empty() {
        return Ok(());
    }
    let list: Vec<String> = broken.iter().map(|(name, link)| format!("{name}: {link}")).collect();
    Err(format!("{} references lead nowhere:\n    {}", list.len(), list.join("\n    ")))
}

/// Endings of files whose text may cite documents, and whose names in documents are checked.
const SOURCES: [&str; 3] = [".rs", ".py", ".proto"];

/// Prose of a Markdown text, without fenced code.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    text.split("```").step_by(2)
}

/// Targets of the relative links of a Markdown text.
fn links(text: &str) -> Vec<String> {
    prose(text)
        .flat_map(|part| part.split("](").skip(1))
        .filter_map(|rest| rest.split([')', ' ', '\n']).next())
        .filter(|link| !link.contains(':'))
        .map(str::to_owned)
        .collect()
}

/// Sources that a Markdown text names in backticks, such as `chart.rs`, and paths below `server/`; those of recipes, with
/// `NAME` in them, are left out.
fn named(text: &str) -> Vec<String> {
    let path = |c: char| c.is_ascii_alphanumeric() || "-_/.".contains(c);
    prose(text)
        .flat_map(|part| part.split('`').skip(1).step_by(2))
        .filter(|code| code.chars().all(path) && !code.contains("NAME"))
        .filter(|code| SOURCES.iter().any(|ending| code.ends_with(ending)) || code.starts_with("server/"))
        .map(str::to_owned)
        .collect()
}

/// Whether a name is the end of the path of a file, or a folder with files.
fn exists(files: &[&str], name: &str) -> bool {
    let name = name.trim_start_matches("../").trim_end_matches('/');
    let is_end =
        |file: &str| file.strip_suffix(name).is_some_and(|rest| rest.is_empty() || rest.ends_with('/'));
    let is_start = |file: &str| file.strip_prefix(name).is_some_and(|rest| rest.starts_with('/'));
    files.iter().any(|file| is_end(file) || is_start(file))
}

/// Documents that a source text cites, with or without an anchor.
fn citations(text: &str) -> Vec<String> {
    let word = |c: char| c.is_ascii_alphanumeric() || "-_/.#".contains(c);
    text.split(|c| !word(c))
        .map(|found| found.trim_end_matches('.'))
        .filter(|found| found.starts_with("docs/") && found.contains(".md"))
        .map(str::to_owned)
        .collect()
}

/// Whether a link, relative to `folder`, in the file at `own`, leads somewhere.
fn leads(folder: &Path, own: &Path, link: &str) -> bool {
    let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
    let target = if file.is_empty() { own.to_owned() } else { folder.join(file) };
    target.exists()
        && (anchor.is_empty()
            || fs::read_to_string(target)
                .is_ok_and(|text| anchors(&text).iter().any(|known| known == anchor)))
}

/// Anchors of a Markdown text: its headings in lower case, spaces as hyphens, other signs left out; and `<a id="...">`.
fn anchors(text: &str) -> Vec<String> {
    let headings = text.lines().filter(|line| line.starts_with('#')).map(|line| {
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let kept = title.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    });
    let named = text.split("<a id=\"").skip(1).filter_map(|rest| rest.split('"').next()).map(str::to_owned);
    headings.chain(named).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_all_references() {
        let text = "[a](b.md#c), [d](https://e.org/f), ![g](h.png \"title\"), `chart.rs`, `x.toml`, `a/NAME.rs`\n\
                    ```\nx[0](y) `z.rs`\n```\n[i](#j)";
        assert_eq!(links(text), ["b.md#c", "h.png", "#j"]);
        assert_eq!(named(text), ["chart.rs"]);
        // In pieces, for these are no citations.
        let cited = [concat!("docs/", "a.md#b"), concat!("docs/", "c.md")];
        assert_eq!(citations(&format!("//! See {}, `{}`.", cited[0], cited[1])), cited);
    }

    #[test]
    fn names_are_ends_of_paths_or_folders() {
        let files = ["server/a/src/chart.rs"];
        for (name, there) in [
            ("chart.rs", true),
            ("src/chart.rs", true),
            ("server/a", true),
            ("../chart.rs", true),
            ("art.rs", false),
        ] {
            assert_eq!(exists(&files, name), there, "{name}");
        }
    }

    #[test]
    fn headings_become_anchors_as_on_github() {
        let text = "# The `eval`, jvp\n## Foot-points (eq. 3)\n<a id=\"seam\"></a>";
        assert_eq!(anchors(text), ["the-eval-jvp", "foot-points-eq-3", "seam"]);
    }
}
