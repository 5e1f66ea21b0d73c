//! A layout for the log of a run: a view in three dimensions, two pictures, log lines, numbers and tables side by side.

use serde_json::{Map, Value, json};

use super::super::topic::Topic;

/// Topics that can be drawn in three dimensions.
const DRAWN: [&str; 3] = ["foxglove.SceneUpdate", "foxglove.PointCloud", "foxglove.Grid"];
/// Curves of a plot at most.
const CURVES: usize = 10;

/// A layout that opens a log with these topics ready to look at, as Foxglove imports it.
pub fn layout(topics: &[Topic], metrics: &[(String, String)]) -> Value {
    let of = |schema: &'static str| topics.iter().filter(move |topic| topic.schema == schema).map(|t| t.name.as_str());
    let pictures: Vec<&str> = of("foxglove.CompressedImage").collect();
    let tables: Vec<&str> = of("rockface.Table").collect();
    let (first, last) = (pictures.first().copied(), pictures.last().copied());
    let mut panels = Map::new();
    let mut add = |name: &str, config: Value| {
        panels.insert(name.to_owned(), config);
        json!(name)
    };
    let scene = add("3D!scene", scene(topics));
    let one = add("Image!first", picture(first));
    let other = add("Image!last", picture(last));
    let lines = add("RosOut!log", json!({"searchTerms": [], "minLogLevel": 1}));
    let plot = add("Plot!numbers", plot(metrics));
    let table = match tables.last() {
        Some(topic) => add("Table!table", json!({"topicPath": format!("{topic}.rows[:]")})),
        None => add("RawMessages!step", json!({"topicPath": of("rockface.Step").next().unwrap_or_default()})),
    };
    let split = |direction: &str, first: Value, second: Value, percent: u32| json!({"direction": direction, "first": first, "second": second, "splitPercentage": percent});
    let left = split("column", scene, split("row", lines, table, 50), 68);
    let right = split("column", one, split("column", other, plot, 52), 36);
    json!({
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": split("row", left, right, 62),
    })
}

/// Everything that can be drawn: the first face and all bodies at once, other faces, clouds and grids on demand, since they
/// cover each other.
fn scene(topics: &[Topic]) -> Value {
    let drawn = topics.iter().filter(|topic| DRAWN.contains(&topic.schema.as_str()));
    let first_mesh = topics.iter().find(|topic| topic.schema == "foxglove.SceneUpdate");
    let config = |topic: &Topic| {
        let is_scene = topic.schema == "foxglove.SceneUpdate";
        // One face is enough; what was taken out of it stands before it.
        let visible = Some(topic) == first_mesh || (is_scene && !topic.name.ends_with("/mesh"));
        let colours = json!({"visible": visible, "colorMode": "colormap", "colorMap": "turbo", "pointSize": 3});
        let colours = match topic.schema.as_str() {
            "foxglove.PointCloud" => merged(&colours, &json!({"colorField": "z"})),
            "foxglove.Grid" => merged(&colours, &json!({"colorMap": "rainbow"})),
            _ => json!({"visible": visible}),
        };
        (topic.name.clone(), colours)
    };
    json!({
        "cameraState": {"distance": 25, "perspective": true, "phi": 20, "thetaOffset": 0, "fovy": 45, "near": 0.1,
                        "far": 10000, "target": [0, 0, 0], "targetOffset": [0, 0, 0],
                        "targetOrientation": [0, 0, 0, 1]},
        "followMode": "follow-none",
        "followTf": "wall",
        "scene": {"transforms": {"labelSize": 0.05, "axisScale": 0.6}},
        "transforms": {},
        "topics": drawn.map(config).collect::<Map<_, _>>(),
        "layers": {},
    })
}

fn merged(one: &Value, other: &Value) -> Value {
    let entries = |value: &Value| value.as_object().cloned().unwrap_or_default();
    entries(one).into_iter().chain(entries(other)).collect()
}

fn picture(topic: Option<&str>) -> Value {
    json!({"imageMode": {"imageTopic": topic.unwrap_or_default()}, "cameraState": {}})
}

fn plot(metrics: &[(String, String)]) -> Value {
    let curve = |(topic, name): &(String, String)| {
        json!({"value": format!("{topic}.values.{name}"), "enabled": true, "timestampMethod": "receiveTime",
               "label": format!("{} {name}", topic.trim_start_matches('/').trim_end_matches("/metrics"))})
    };
    json!({
        "paths": metrics.iter().take(CURVES).map(curve).collect::<Vec<_>>(),
        "xAxisVal": "timestamp", "showLegend": true, "legendDisplay": "floating", "showXAxisLabels": true,
        "showYAxisLabels": true, "isSynced": true,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_panel_of_the_layout_is_configured_and_shows_topics_there_are() {
        let topic = |name: &str, schema: &str| Topic { name: name.into(), schema: schema.into() };
        let topics = [
            topic("/face/step", "rockface.Step"),
            topic("/face/mesh", "foxglove.SceneUpdate"),
            topic("/depth/depth", "foxglove.CompressedImage"),
            topic("/depth/depth/cloud", "foxglove.PointCloud"),
        ];
        let made = layout(&topics, &[("/depth/metrics".into(), "valid_share".into())]);
        let mut open = vec![&made["layout"]];
        let mut panels = 0;
        while let Some(node) = open.pop() {
            match node.as_str() {
                Some(name) => {
                    assert!(made["configById"][name].is_object(), "{name}");
                    panels += 1;
                }
                None => open.extend([&node["first"], &node["second"]]),
            }
        }
        assert_eq!(panels, 6);
        assert_eq!(made["configById"]["3D!scene"]["topics"]["/face/mesh"]["visible"], true);
        assert_eq!(made["configById"]["Image!last"]["imageMode"]["imageTopic"], "/depth/depth");
        assert_eq!(made["configById"]["Plot!numbers"]["paths"][0]["value"], "/depth/metrics.values.valid_share");
    }
}
