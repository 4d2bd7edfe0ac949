//! `summary.json`: every number of the report, the same bytes for the same evaluation.

use serde_json::{Map, Value, json};

use super::{Report, Section};
use crate::Quantity;
use crate::policy_sets::{PolicySet, SetMember};
use crate::section_content::{Claim, Row, Table};
use crate::statistics::{Comparison, Numbers};

/// Returns the summary of a report as JSON.
pub fn json(report: &Report) -> String {
    let policy = |(set, member): (&PolicySet, &SetMember)| {
        json!({
            "set": set.name, "seed": member.seed, "sha256": member.agent.sha256, "config": member.config_name(),
            "samples": member.samples(), "trained_by": member.revision(),
        })
    };
    let policies: Vec<Value> = report.policies.members().map(policy).collect();
    let experiments: Vec<Value> = report.sections.iter().map(|section| experiment(section, &report.names)).collect();
    let missing: Vec<&str> = report.missing.iter().map(|info| info.name).collect();
    let mut whole = json!({
        "sets": report.names,
        "training": report.policies.training(),
        "differing_keys": report.policies.differing_keys(),
        "policies": policies,
        "protocol": report.protocol,
        "notes": report.notes,
        "experiments": experiments,
        "not_run": missing,
    });
    if !report.sensing.experiments.is_empty() {
        whole["sensing"] = sensing(report);
    }
    // A tree of texts and numbers: serialising it cannot fail.
    let mut text = serde_json::to_string_pretty(&rounded(whole)).unwrap_or_default();
    text.push('\n');
    text
}

/// Returns E12: all numbers with estimates and with the true state, and the errors of the estimates.
fn sensing(report: &Report) -> Value {
    let found = &report.sensing;
    let tables = found.tables();
    json!({
        "experiments": found.experiments,
        "notes": found.notes,
        "contact_network": found.network,
        "tables": tables.iter().map(|(table, names)| self::table(table, names)).collect::<Map<_, _>>(),
    })
}

/// Returns a table's name and rows.
fn table(table: &Table, names: &[String]) -> (String, Value) {
    let row = |row: &Row| {
        json!({
            "condition": row.condition, "quantity": row.quantity.name, "unit": row.quantity.unit, "paper": row.paper,
            "ours": comparison(names, &row.comparison, row.quantity),
        })
    };
    (table.name.clone(), Value::Array(table.rows.iter().map(row).collect()))
}

fn experiment(section: &Section, names: &[String]) -> Value {
    let ends: Map<String, Value> = names.iter().cloned().zip(section.ends.iter().map(|ends| json!(ends))).collect();
    let claim = |claim: &Claim| {
        json!({
            "claim": claim.text, "paper": claim.paper, "quantity": claim.quantity.name, "unit": claim.quantity.unit,
            "verdict": claim.verdict, "ours": comparison(names, &claim.comparison, claim.quantity),
        })
    };
    let claims: Vec<Value> = section.content.claims.iter().map(claim).collect();
    json!({
        "id": section.info.id,
        "name": section.info.name,
        "paper": section.info.paper,
        "parameters": section.parameters,
        "trials_of_each_condition_and_policy": section.info.trials,
        "trials": ends,
        "claims": claims,
        "notes": section.content.notes,
        "tables": section.content.tables.iter().map(|table| self::table(table, names)).collect::<Map<_, _>>(),
        "lines": section.content.lines,
    })
}

/// Returns a comparison in the quantity's unit; a relative change of 10 % is 0.1.
fn comparison(names: &[String], comparison: &Comparison, quantity: Quantity) -> Value {
    let comparison = comparison.scaled(quantity.scale());
    let set = |(name, Numbers { by_seed, spread, .. }): (&String, &Numbers)| {
        let (mean, sd) = (spread.map(|spread| spread.mean), spread.and_then(|spread| spread.sd));
        (name.clone(), json!({ "mean": mean, "sd": sd, "by_seed": by_seed }))
    };
    let sets: Map<String, Value> = names.iter().zip(&comparison.sets).map(set).collect();
    let Comparison { difference, relative, trials, .. } = comparison;
    json!({ "sets": sets, "difference": difference, "relative": relative, "trials": trials })
}

/// Rounds all numbers of a value to six significant digits.
fn rounded(value: Value) -> Value {
    match value {
        Value::Number(number) if number.is_f64() => {
            let number = number.as_f64().unwrap_or(0.0);
            // Also turns −0 into 0.
            json!(format!("{number:.5e}").parse::<f64>().unwrap_or(number) + 0.0)
        }
        Value::Array(values) => Value::Array(values.into_iter().map(rounded).collect()),
        Value::Object(object) => Value::Object(object.into_iter().map(|(key, value)| (key, rounded(value))).collect()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_wherever_they_stand() {
        let found = rounded(json!({"a": [0.1 + 0.2, 123_456_789.0, -0.0], "b": 3, "c": "0.30000000000000004"}));
        assert_eq!(found.to_string(), r#"{"a":[0.3,123457000.0,0.0],"b":3,"c":"0.30000000000000004"}"#);
    }
}
