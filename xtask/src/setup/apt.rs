//! Debian's packages: which sources this machine has, and the steps that install what is missing.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, anyhow};

use crate::process;

const KEYRING: &str = "/usr/share/keyrings/debian-archive-keyring.gpg";

/// Packages that are missing and the release they must come from.
pub(crate) struct Packages {
    /// Package names.
    pub(crate) names: Vec<&'static str>,
    /// `apt-get install -t`; `None` for the release that the machine runs.
    pub(crate) release: Option<String>,
    /// A source to add first, where the machine does not have that release among its sources.
    pub(crate) source: Option<SourceFile>,
}

impl Packages {
    /// A package of the release that the machine runs.
    pub(super) fn of(name: &'static str) -> Self {
        Self { names: vec![name], release: None, source: None }
    }
}

/// A file of our own under `/etc/apt/sources.list.d`.
pub(crate) struct SourceFile {
    path: PathBuf,
    lines: Vec<String>,
}

impl SourceFile {
    fn shell_line(&self) -> String {
        let lines: Vec<String> = self.lines.iter().map(process::quoted).collect();
        format!(r"printf '%s\n' {} > {}", lines.join(" "), self.path.display())
    }

    fn write(&self) -> Result<()> {
        eprintln!("+ {}", self.shell_line());
        fs::write(&self.path, self.lines.join("\n") + "\n")
            .with_context(|| format!("cannot write the apt source {}", self.path.display()))
    }
}

/// Installs all `wanted`, printing each command first.
pub(crate) fn install(wanted: &[Packages]) -> Result<()> {
    let added: Vec<&SourceFile> = wanted.iter().filter_map(|packages| packages.source.as_ref()).collect();
    for source in &added {
        source.write()?;
    }
    if let Err(error) = process::run(&mut update()) {
        // A source that does not work would break every later `apt-get update` on this machine.
        for source in &added {
            fs::remove_file(&source.path)
                .with_context(|| format!("cannot take back {}", source.path.display()))?;
        }
        return Err(error.context("apt cannot read its sources; repair them and start again"));
    }
    wanted.iter().try_for_each(|packages| process::run(&mut packages.install_command()))
}

/// The commands that [`install`] would run, for a person to type.
pub(crate) fn shell_lines(wanted: &[Packages]) -> Vec<String> {
    let sources = wanted.iter().filter_map(|packages| packages.source.as_ref()).map(SourceFile::shell_line);
    let installs = wanted.iter().map(|packages| process::shell_line(&packages.install_command()));
    sources.chain([process::shell_line(&update())]).chain(installs).collect()
}

impl Packages {
    fn install_command(&self) -> Command {
        let mut command = Command::new("apt-get");
        command.env("DEBIAN_FRONTEND", "noninteractive");
        command.args(["install", "--yes", "--no-install-recommends"]);
        if let Some(release) = &self.release {
            command.args(["-t", release]);
        }
        command.args(&self.names);
        command
    }
}

fn update() -> Command {
    let mut command = Command::new("apt-get");
    command.arg("update");
    command
}

/// The source file to add so that `suite` is among this machine's sources; `None` where it is already.
///
/// The mirror is the one that `base_suite` comes from, so a machine behind a mirror of its own keeps to it.
pub(crate) fn source_for(base_suite: &str, suite: &str) -> Result<Option<SourceFile>> {
    let sources = sources_below(Path::new("/etc/apt"))?;
    if sources.iter().any(|source| source.serves(suite)) {
        return Ok(None);
    }
    let base = sources.iter().find(|source| source.serves(base_suite)).ok_or_else(|| {
        anyhow!("no apt source serves {base_suite} main, so the mirror for {suite} is unknown; add {suite} to the apt sources by hand")
    })?;
    let lines = vec![
        "Types: deb".to_owned(),
        format!("URIs: {}", base.uri),
        format!("Suites: {suite}"),
        "Components: main".to_owned(),
        format!("Signed-By: {}", base.signed_by.as_deref().unwrap_or(KEYRING)),
    ];
    let path = PathBuf::from(format!("/etc/apt/sources.list.d/wsg-{suite}.sources"));
    Ok(Some(SourceFile { path, lines }))
}

fn sources_below(apt: &Path) -> Result<Vec<Source>> {
    let mut files = vec![apt.join("sources.list")];
    if let Ok(entries) = fs::read_dir(apt.join("sources.list.d")) {
        files.extend(entries.flatten().map(|entry| entry.path()));
    }
    files.sort();
    let mut sources = Vec::new();
    for file in files {
        let parse = match file.extension().and_then(|extension| extension.to_str()) {
            Some("list") => parse_one_line_style,
            Some("sources") => parse_deb822,
            _ => continue,
        };
        if file.exists() {
            let text = fs::read_to_string(&file)
                .with_context(|| format!("cannot read the apt source {}", file.display()))?;
            sources.extend(parse(&text));
        }
    }
    Ok(sources)
}

/// One enabled source of binary packages (sources.list(5)).
#[derive(Debug, PartialEq)]
struct Source {
    uri: String,
    suites: Vec<String>,
    components: Vec<String>,
    /// The keyring's path; `None` where the key is not given, or given in place.
    signed_by: Option<String>,
}

impl Source {
    fn serves(&self, suite: &str) -> bool {
        self.suites.iter().any(|it| it == suite) && self.components.iter().any(|it| it == "main")
    }

    fn new(uris: &[String], suites: Vec<String>, components: Vec<String>, signed_by: &str) -> Option<Self> {
        // A CD is no mirror: it can not have the backports.
        let uri = uris.iter().find(|uri| !uri.starts_with("cdrom:"))?.clone();
        let signed_by = signed_by.starts_with('/').then(|| signed_by.to_owned());
        Some(Self { uri, suites, components, signed_by })
    }
}

/// `deb [signed-by=/keyring] uri suite component...`, one source per line.
fn parse_one_line_style(text: &str) -> Vec<Source> {
    text.lines().filter_map(parse_line).collect()
}

fn parse_line(line: &str) -> Option<Source> {
    let line = line.split('#').next()?.trim();
    let rest = line.strip_prefix("deb")?.strip_prefix([' ', '\t'])?.trim_start();
    let (options, rest) = match rest.strip_prefix('[') {
        Some(options) => options.split_once(']')?,
        None => ("", rest),
    };
    let mut rest = words(rest).into_iter();
    let (uri, suite) = (rest.next()?, rest.next()?);
    let signed_by = options.split_whitespace().find_map(|option| option.strip_prefix("signed-by="));
    Source::new(&[uri], vec![suite], rest.collect(), signed_by.unwrap_or_default())
}

/// Paragraphs of `Field: value`, a value going on in lines that start with white space.
fn parse_deb822(text: &str) -> Vec<Source> {
    let mut sources = Vec::new();
    let mut paragraph: Vec<(String, String)> = Vec::new();
    for line in text.lines().chain([""]) {
        if line.starts_with('#') {
            continue;
        }
        if line.trim().is_empty() {
            sources.extend(source_of(&paragraph));
            paragraph.clear();
        } else if line.starts_with([' ', '\t']) {
            if let Some((_, value)) = paragraph.last_mut() {
                value.push_str(line);
            }
        } else if let Some((field, value)) = line.split_once(':') {
            paragraph.push((field.to_ascii_lowercase(), value.trim().to_owned()));
        }
    }
    sources
}

fn source_of(paragraph: &[(String, String)]) -> Option<Source> {
    let field = |name: &str| {
        paragraph.iter().find(|(field, _)| field == name).map_or("", |(_, value)| value.as_str())
    };
    let disabled = matches!(field("enabled").to_ascii_lowercase().as_str(), "no" | "false" | "0" | "off");
    if disabled || !words(field("types")).iter().any(|it| it == "deb") {
        return None;
    }
    Source::new(
        &words(field("uris")),
        words(field("suites")),
        words(field("components")),
        field("signed-by").trim(),
    )
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deb822_paragraphs_are_read_with_comments_inside() {
        let text = "Types: deb\n# a comment\nURIs: http://mirror.example/debian\nSuites: bookworm bookworm-updates\n\
                    Components: main\nSigned-By: /keys/debian.gpg\n\nTypes: deb deb-src\nUris: http://mirror.example/security\n\
                    Suites: bookworm-security\nComponents: main\n contrib\n";

        let sources = parse_deb822(text);

        assert_eq!(sources.len(), 2);
        assert_eq!(sources[0].uri, "http://mirror.example/debian");
        assert_eq!(sources[0].signed_by.as_deref(), Some("/keys/debian.gpg"));
        assert!(sources[0].serves("bookworm") && sources[0].serves("bookworm-updates"));
        assert!(!sources[0].serves("bookworm-backports"));
        assert_eq!(sources[1].components, ["main", "contrib"]);
        assert_eq!(sources[1].signed_by, None);
    }

    #[test]
    fn a_disabled_or_source_only_paragraph_serves_nothing() {
        let text = "Enabled: no\nTypes: deb\nURIs: http://a.example\nSuites: bookworm\nComponents: main\n\n\
                    Types: deb-src\nURIs: http://a.example\nSuites: bookworm\nComponents: main\n";

        assert_eq!(parse_deb822(text), []);
    }

    #[test]
    fn a_key_given_in_place_is_not_taken_for_a_path() {
        let text = "Types: deb\nURIs: http://a.example\nSuites: bookworm\nComponents: main\nSigned-By:\n -----BEGIN PGP\n .\n abc\n";

        assert_eq!(parse_deb822(text)[0].signed_by, None);
    }

    #[test]
    fn one_line_style_is_read_with_and_without_options() {
        let text = "# deb http://no.example bookworm main\n\
                    deb http://a.example/debian bookworm main contrib # comment\n\
                    deb-src http://a.example/debian bookworm main\n\
                    deb [ arch=amd64 signed-by=/keys/x.gpg ] https://b.example/debian\tbookworm-backports main\n\
                    debris\n";

        let sources = parse_one_line_style(text);

        assert_eq!(sources.len(), 2);
        assert!(sources[0].serves("bookworm"));
        assert_eq!(sources[1].uri, "https://b.example/debian");
        assert_eq!(sources[1].signed_by.as_deref(), Some("/keys/x.gpg"));
        assert!(sources[1].serves("bookworm-backports"));
    }

    #[test]
    fn a_cd_is_no_mirror() {
        assert_eq!(parse_one_line_style("deb cdrom:[Debian]/ bookworm main"), []);
    }

    #[test]
    fn steps_for_a_person_write_the_source_update_once_and_install() {
        let source = SourceFile { path: "/etc/x.sources".into(), lines: vec!["Types: deb".into()] };
        let wanted = [
            Packages { names: vec!["lld"], release: None, source: None },
            Packages { names: vec!["qemu"], release: Some("r-backports".into()), source: Some(source) },
        ];

        let install = "DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends";
        let expected = [
            r"printf '%s\n' 'Types: deb' > /etc/x.sources".to_owned(),
            "apt-get update".to_owned(),
            format!("{install} lld"),
            format!("{install} -t r-backports qemu"),
        ];
        assert_eq!(shell_lines(&wanted), expected);
    }
}
