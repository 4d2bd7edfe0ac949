//! Every number as JSON, the same bytes for the same evaluation.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use super::{Report, Section};
use crate::evaluate::findings::{Row, Table};
use crate::evaluate::results::Results;
use crate::evaluate::sensing::NAMES;
use crate::evaluate::statistics::Comparison;

/// All conditions and quantities of an experiment.
pub fn numbers(results: &Results) -> Value {
    let of_condition = |condition: usize| {
        let quantities: BTreeMap<&str, Value> = results
            .quantities
            .iter()
            .map(|quantity| (quantity.name, comparison(&results.names, &results.compare(condition, quantity.name))))
            .collect();
        json!({ "condition": results.conditions[condition].label, "quantities": quantities })
    };
    Value::Array((0..results.conditions.len()).map(of_condition).collect())
}

/// The whole summary.
pub fn json(report: &Report) -> String {
    let policies: Vec<Value> = report
        .policies
        .iter()
        .map(|policy| {
            json!({
                "set": policy.set, "seed": policy.seed, "sha256": policy.sha256, "config": policy.config,
                "samples": policy.samples, "trained_by": policy.revision,
            })
        })
        .collect();
    let experiments: Vec<Value> = report.sections.iter().map(|section| experiment(section, &report.names)).collect();
    let missing: Vec<&str> = report.missing.iter().map(|info| info.name).collect();
    let mut whole = json!({
        "sets": report.names,
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

/// E12: all numbers both ways, and the errors of the estimates.
fn sensing(report: &Report) -> Value {
    let found = &report.sensing;
    let rows = |table: &Table, names: &[String; 2]| -> Vec<Value> {
        let row = |row: &Row| {
            json!({
                "condition": row.condition, "quantity": row.quantity.name, "unit": row.quantity.unit,
                "ours": comparison(names, &row.comparison),
            })
        };
        table.rows.iter().map(row).collect()
    };
    let ways = NAMES.map(ToOwned::to_owned);
    json!({
        "experiments": found.experiments,
        "contact_network": found.network,
        "numbers": rows(&found.all, &ways),
        "errors": rows(&found.errors, &report.names),
    })
}

fn experiment(section: &Section, names: &[String; 2]) -> Value {
    let ends: Map<String, Value> = names.iter().cloned().zip(section.ends.map(|ends| json!(ends))).collect();
    let claims: Vec<Value> = section
        .findings
        .claims
        .iter()
        .map(|claim| {
            json!({
                "claim": claim.text, "paper": claim.paper, "quantity": claim.quantity.name,
                "unit": claim.quantity.unit, "verdict": claim.verdict, "ours": comparison(names, &claim.comparison),
            })
        })
        .collect();
    json!({
        "id": section.info.id,
        "name": section.info.name,
        "paper": section.info.paper,
        "parameters": section.parameters,
        "trials_of_each_condition_and_policy": section.trials,
        "trials": ends,
        "claims": claims,
        "notes": section.findings.notes,
        "numbers": section.numbers,
    })
}

fn comparison(names: &[String; 2], comparison: &Comparison) -> Value {
    let mut object = Map::new();
    let sides = [(&comparison.a, comparison.a_spread), (&comparison.b, comparison.b_spread)];
    for (name, (seeds, spread)) in names.iter().zip(sides) {
        let by_seed: Map<String, Value> = seeds.iter().map(|(seed, value)| (seed.to_string(), json!(value))).collect();
        object.insert(
            name.clone(),
            json!({ "mean": spread.map(|s| s.mean), "sd": spread.and_then(|s| s.sd), "by_seed": by_seed }),
        );
    }
    object.insert("difference".into(), json!(comparison.difference));
    object.insert("relative".into(), json!(comparison.relative));
    Value::Object(object)
}

/// Numbers to six significant digits: the rest is not knowledge.
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
