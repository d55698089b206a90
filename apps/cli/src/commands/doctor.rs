use crate::bar::Bar;
use crate::{Common, out};

#[derive(clap::Args)]
pub struct Doctor {}

impl Doctor {
    pub fn run(&self, common: &Common) -> anyhow::Result<()> {
        let bar = Bar::new(common);
        let findings = animimic::doctor::examine(&bar);
        drop(bar);
        let json = findings.iter().map(animimic::doctor::Finding::to_json).collect();
        out::print(common, &serde_json::Value::Array(json), || {
            let row = |f: &animimic::doctor::Finding| {
                let fix = f.fix.as_ref().map(|fix| format!("\n{:24} → {fix}", "")).unwrap_or_default();
                format!("{:4} {:19} {}{fix}\n", f.state.word(), f.what, f.found)
            };
            findings.iter().map(row).collect()
        })
    }
}
