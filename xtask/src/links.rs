//! Links between documents: every relative link of a Markdown file, and every `docs/*.md` that a source file cites, leads to a
//! file and, after `#`, to a heading in it.

use std::{fs, path::Path};

use crate::process::{Outcome, command, root};

/// Checks all files under version control and new ones.
pub fn check() -> Outcome {
    eprintln!("\n==> links between documents");
    let mut git = command("git");
    git.args([
        "ls-files",
        "--cached",
        "--others",
        "--exclude-standard",
        "--",
        "*.md",
        "*.rs",
        "*.py",
        "*.proto",
    ]);
    let listed = git.output().map_err(|error| format!("cannot run git: {error}"))?;
    let mut broken = Vec::new();
    for name in String::from_utf8_lossy(&listed.stdout).lines() {
        let path = root().join(name);
        // A file removed from the work tree only.
        let Ok(text) = fs::read_to_string(&path) else { continue };
        let folder = path.parent().unwrap_or(root());
        let found: Vec<String> = if name.ends_with(".md") {
            links(&text).into_iter().filter(|link| !leads(folder, &path, link)).collect()
        } else {
            citations(&text).into_iter().filter(|link| !leads(root(), &path, link)).collect()
        };
        broken.extend(found.into_iter().map(|link| format!("{name}: {link}")));
    }
    if broken.is_empty() {
        Ok(())
    } else {
        Err(format!("{} links lead nowhere:\n    {}", broken.len(), broken.join("\n    ")))
    }
}

/// Targets of the links of a Markdown text, outside fenced code, that are relative.
fn links(text: &str) -> Vec<String> {
    let prose = text.split("```").step_by(2);
    prose
        .flat_map(|part| part.split("](").skip(1))
        .filter_map(|rest| rest.split([')', ' ', '\n']).next())
        .filter(|link| !link.contains(':'))
        .map(str::to_owned)
        .collect()
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
    fn finds_what_can_break() {
        let text = "[a](b.md#c) and [d](https://e.org/f) ![g](h.png \"title\")\n```\nx[0](y)\n```\n[i](#j)";
        assert_eq!(links(text), ["b.md#c", "h.png", "#j"]);
        // In pieces, for these are no citations.
        let cited = [concat!("docs/", "a.md#b"), concat!("docs/", "c.md")];
        assert_eq!(citations(&format!("//! See {}, `{}`.", cited[0], cited[1])), cited);
    }

    #[test]
    fn headings_become_anchors_as_on_github() {
        let text = "# The `eval`, jvp\n## Foot-points (eq. 3)\n<a id=\"seam\"></a>";
        assert_eq!(anchors(text), ["the-eval-jvp", "foot-points-eq-3", "seam"]);
    }
}
