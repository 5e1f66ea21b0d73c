//! The book in `docs/`: its pages are in its contents, its links lead somewhere, its commands are commands, and what the program
//! writes of it is current.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::CommandFactory;

use crate::cli::{House, SMALL};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The Markdown files of the book, relative to `docs/`, with their texts.
pub fn pages() -> Vec<(PathBuf, String)> {
    let docs = root().join("docs");
    let (mut found, mut folders) = (Vec::new(), vec![docs.clone()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                let text = std::fs::read_to_string(&path).unwrap();
                found.push((path.strip_prefix(&docs).unwrap().to_path_buf(), text));
            }
        }
    }
    found.sort();
    assert!(found.len() > 30);
    found
}

/// Text without blocks of code.
fn prose(text: &str) -> String {
    text.split("```").step_by(2).collect()
}

/// Targets of the links and pictures of a page.
fn links(text: &str) -> Vec<String> {
    let text = prose(text);
    let after = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    after.map(str::to_owned).collect()
}

/// The anchor that mdBook and GitHub give a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|letter| letter.is_alphanumeric() || matches!(letter, ' ' | '-' | '_'));
    kept.collect::<String>().replace(' ', "-")
}

#[test]
fn every_page_is_in_the_contents() {
    let contents = std::fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    let named: BTreeSet<String> = links(&contents).into_iter().collect();
    for (path, _) in pages() {
        let name = path.to_str().unwrap();
        assert!(name == "SUMMARY.md" || named.contains(name), "docs/{name} is not in docs/SUMMARY.md");
    }
}

#[test]
fn every_link_leads_somewhere() {
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let mut documents: Vec<(PathBuf, String)> =
        pages().into_iter().map(|(path, text)| (Path::new("docs").join(path), text)).collect();
    documents.push(("README.md".into(), readme));
    let mut seen = 0;
    for (document, text) in &documents {
        for link in links(text).into_iter().filter(|link| !link.starts_with("http")) {
            let (file, heading) = link.split_once('#').map_or((link.as_str(), None), |(file, part)| (file, Some(part)));
            let target =
                if file.is_empty() { root().join(document) } else { root().join(document).with_file_name(file) };
            assert!(target.exists(), "{}: the link {link} leads nowhere", document.display());
            if let Some(heading) = heading {
                let text = std::fs::read_to_string(&target).unwrap();
                let mut headings =
                    text.lines().filter(|line| line.starts_with('#')).map(|line| anchor(line.trim_start_matches('#')));
                assert!(headings.any(|known| known == heading), "{}: no heading for {link}", document.display());
            }
            seen += 1;
        }
    }
    assert!(seen > 100, "only {seen} links");
}

#[test]
fn what_the_program_writes_of_the_book_is_current() {
    let house = House::new(SMALL);
    let there = root().join("docs/reference");
    if std::env::var_os("ROCKFACE_BLESS").is_some() {
        let (code, _, err) = house.rockface(&["manual", "reference", there.to_str().unwrap()]);
        assert_eq!(code, Some(0), "{err}");
    }
    let (code, _, err) = house.rockface(&["manual", "reference", "written"]);
    assert_eq!(code, Some(0), "{err}");
    let mut folders = vec![house.path("written")];
    let mut seen = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(house.path("written")).unwrap().to_path_buf();
            let kept = std::fs::read_to_string(there.join(&name)).unwrap_or_default();
            let way = "`ROCKFACE_BLESS=1 cargo test --test house book` writes it anew";
            assert!(
                kept == std::fs::read_to_string(&path).unwrap(),
                "docs/reference/{} is not current; {way}",
                name.display()
            );
            seen += 1;
        }
    }
    assert!(seen > 15, "only {seen} files");
}

/// Lines of the shell in `sh` and `text` blocks that call the program, continued lines joined.
fn commands(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for kind in ["```sh\n", "```text\n"] {
        for block in text.split(kind).skip(1).filter_map(|rest| rest.split("```").next()) {
            let lines = block.replace("\\\n", " ");
            found.extend(lines.lines().filter(|line| line.starts_with("rockface ")).map(str::to_owned));
        }
    }
    found
}

/// The words of a line of the shell, as far as documentation uses it: quotes, a comment, a redirection.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), String::new(), None);
    for letter in line.chars() {
        match (letter, quote) {
            ('\'' | '"', None) => quote = Some(letter),
            (letter, Some(open)) if letter == open => quote = None,
            ('#' | '>', None) if word.is_empty() => break,
            (' ', None) => words.extend((!word.is_empty()).then(|| std::mem::take(&mut word))),
            (letter, _) => word.push(letter),
        }
    }
    words.extend((!word.is_empty()).then_some(word));
    words
}

#[test]
fn every_command_of_the_documentation_is_one() {
    let mut documents = pages();
    for name in ["README.md", "python/README.md", "CONTRIBUTING.md"] {
        documents.push((name.into(), std::fs::read_to_string(root().join(name)).unwrap()));
    }
    let usage = |text: &str| text.contains('<') || text.contains("[OPTIONS]");
    let mut seen = 0;
    for (path, text) in documents.iter().filter(|(path, _)| !path.starts_with("reference/commands.md")) {
        for line in commands(text).into_iter().filter(|line| !usage(line)) {
            let parsed = rockface::cli::Cli::command().try_get_matches_from(words(&line));
            let fault = parsed.err().filter(clap::Error::use_stderr);
            assert!(fault.is_none(), "{}: {line}\n{}", path.display(), fault.unwrap());
            seen += 1;
        }
    }
    assert!(seen > 40, "only {seen} commands");
}

#[test]
fn the_readme_is_short() {
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let count = readme.split_whitespace().count();
    assert!(count <= 1200, "README.md has {count} words; what is more than an overview belongs into docs/");
}

/// The tutorial, played from its first command to its last.
#[test]
fn the_tutorial_plays() {
    if std::env::var_os("ROCKFACE_SLOW").is_none() {
        println!("not played: it takes a minute of a release build, ten of a debug build; ROCKFACE_SLOW=1 plays it");
        return;
    }
    let text = std::fs::read_to_string(root().join("docs/tutorial.md")).unwrap();
    let blocks = text.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
    let script = format!("set -e\n{}", blocks.collect::<String>());
    let house = House::new(SMALL);
    let program = Path::new(env!("CARGO_BIN_EXE_rockface")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap_or_default());
    let mut shell = std::process::Command::new("bash");
    let result =
        shell.args(["-c", &script]).env("PATH", path).env_remove("ROCKFACE_STORE").current_dir(house.path("")).output();
    let result = result.unwrap();
    let (out, err) = (String::from_utf8_lossy(&result.stdout), String::from_utf8_lossy(&result.stderr));
    assert!(result.status.success(), "{script}\n{out}\n{err}");
    // Results as the page has them; times and names of runs differ.
    let is_result = |line: &&str| {
        ["verdict:", "score:", "rockfall:", "event/", "made by", "stage "].iter().any(|word| line.starts_with(word))
    };
    let shown: Vec<&str> = text
        .split("```text\n")
        .skip(1)
        .filter_map(|rest| rest.split("```").next())
        .flat_map(str::lines)
        .filter(is_result)
        .collect();
    assert!(shown.len() > 10, "{shown:?}");
    for line in shown {
        assert!(out.lines().any(|printed| printed == line), "the page has `{line}`, the program\n{out}");
    }
}

/// A value against the part of JSON Schema that the schema of events uses.
fn fits(value: &serde_json::Value, schema: &serde_json::Value) -> bool {
    if let Some(constant) = schema.get("const") {
        return value == constant;
    }
    if let Some(choices) = schema.get("enum").and_then(|choices| choices.as_array()) {
        return choices.contains(value);
    }
    let is = |kind: &str| match kind {
        "string" => value.is_string(),
        "integer" => value.is_u64(),
        "number" => value.is_number(),
        "boolean" => value.is_boolean(),
        "array" => value.as_array().is_some_and(|items| items.iter().all(|item| fits(item, &schema["items"]))),
        "null" => value.is_null(),
        "object" => true,
        other => panic!("a type `{other}`"),
    };
    match &schema["type"] {
        serde_json::Value::String(kind) if kind == "object" => {
            let (members, properties) = (value.as_object().unwrap(), schema["properties"].as_object().unwrap());
            let required = schema["required"].as_array().unwrap();
            required.iter().all(|name| members.contains_key(name.as_str().unwrap()))
                && members.iter().all(|(name, value)| properties.get(name).is_some_and(|schema| fits(value, schema)))
        }
        serde_json::Value::String(kind) => is(kind),
        serde_json::Value::Array(kinds) => kinds.iter().any(|kind| is(kind.as_str().unwrap())),
        other => panic!("a type {other}"),
    }
}

#[test]
fn the_events_of_runs_fit_their_schema() {
    let house = House::new(&SMALL.replace("method: tin", "method: tin, window_m: [0, 1, 0, 1e9]"));
    let (_, schema, _) = house.rockface(&["manual", "events"]);
    let schema: serde_json::Value = serde_json::from_str(&schema).unwrap();
    let mut told = BTreeSet::new();
    for arguments in [
        &["run", "p.yaml", "--json"][..],
        &["run", "p.yaml", "--json", "--set", "steps.dem.with.window_m=null"],
        &["run", "p.yaml", "--json", "--set", "steps.dem.with.window_m=null"],
    ] {
        let (_, out, _) = house.rockface(arguments);
        for line in out.lines() {
            let line: serde_json::Value = serde_json::from_str(line).unwrap();
            let fitting = schema["oneOf"].as_array().unwrap().iter().filter(|event| fits(&line, event)).count();
            assert_eq!(fitting, 1, "{line}");
            told.insert(line["event"].as_str().unwrap().to_owned());
        }
        let first: serde_json::Value = serde_json::from_str(out.lines().next().unwrap()).unwrap();
        assert_eq!((&first["event"], &first["version"]), (&"planned".into(), &1.into()));
    }
    for event in ["planned", "cached", "started", "finished", "failed", "ended"] {
        assert!(told.contains(event), "no event `{event}`: {told:?}");
    }
}

#[test]
fn shells_are_told_steps_stages_parts_and_runs() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml", "--quiet"]);
    let asked = |words: &[&str]| {
        let mut command = house.command(&[]);
        command.args(["--", "rockface"]).args(words);
        command.env("ROCKFACE_COMPLETE", "fish");
        String::from_utf8(command.output().unwrap().stdout).unwrap()
    };
    for (words, offered) in [
        (&["run", "p.yaml", "--target", "d"][..], "dem"),
        (&["explain", "p.yaml", "fa"], "face"),
        (&["explain", "quickstart", "surv"], "survey"),
        (&["stages", "rasterise-d"], "rasterise-dem"),
        (&["parts", "rockface/ste"], "rockface/stereo-survey"),
        (&["run", "quick"], "quickstart"),
        (&["run", "p"], "p.yaml"),
        (&["report", "la"], "latest"),
        (&["report", "sm"], "small"),
        (&["export", "latest", "dem"], "dem.raster"),
        (&["init", "x", "--from", "outc"], "outcrop"),
    ] {
        let said = asked(words);
        assert!(said.lines().any(|line| line.split('\t').next() == Some(offered)), "{words:?}: {said}");
    }
    assert_eq!(asked(&["stages", "no-such"]), "");
}

#[test]
fn shells_are_not_told_names_that_are_commands() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml", "--quiet"]);
    let runs = house.path(".rockface/runs");
    let run = std::fs::read_link(runs.join("latest")).unwrap();
    for evil in ["zz$(touch${IFS}PWNED)", "zz;id", "zz`id`", "zz\u{1b}[2J", "zz fine"] {
        std::fs::create_dir(runs.join(evil)).unwrap();
        std::fs::copy(runs.join(&run).join("run.json"), runs.join(evil).join("run.json")).unwrap();
        std::fs::write(house.path(&format!("{evil}.yaml")), "").unwrap();
    }
    std::fs::create_dir(runs.join("zz-fine")).unwrap();
    std::fs::copy(runs.join(&run).join("run.json"), runs.join("zz-fine/run.json")).unwrap();
    std::fs::write(house.path("zz-fine.yaml"), "").unwrap();
    for shell in ["bash", "fish", "zsh", "elvish"] {
        let asked = |words: &[&str]| {
            let mut command = house.command(&[]);
            command.args(["--", "rockface"]).args(words);
            command.env("ROCKFACE_COMPLETE", shell).env("_CLAP_COMPLETE_INDEX", words.len().to_string());
            String::from_utf8(command.output().unwrap().stdout).unwrap()
        };
        assert_eq!(asked(&["report", "zz"]).trim_end(), "zz-fine", "{shell}");
        // Shells other than bash quote names of files.
        if shell == "bash" {
            assert_eq!(asked(&["run", "zz"]).trim_end(), "zz-fine.yaml");
            assert_eq!(asked(&["run", "p.yaml", "--store", "zz"]).trim_end(), "zz-fine.yaml");
        }
        assert!(asked(&["run", "p.yaml", "--sto"]).contains("--store"), "{shell}");
    }
}

#[test]
fn manual_pages_are_made_for_every_command() {
    let house = House::new(SMALL);
    let (code, out, err) = house.rockface(&["manual", "pages", "man"]);
    assert_eq!(code, Some(0), "{out}{err}");
    for name in ["rockface", "rockface-run", "rockface-runs-compare", "rockface-store-gc"] {
        let page = std::fs::read_to_string(house.path(&format!("man/{name}.1"))).unwrap();
        assert!(page.contains(".SH SYNOPSIS") && page.contains(".SH OPTIONS"), "{name}: {page}");
    }
}
