//! Faulty set-ups, each rejected with the field, index and value in the message.

mod common;

use common::{document, files, read, refused, refused_with};
use moldline_setup_files::{Files, Limits, read_setup};
use serde_json::json;

/// The set-up as TOML, which can write `nan` and `inf`.
fn toml_with(line: &str) -> String {
    let text = format!(
        r#"
format = 1
[mesh]
vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
cells = [[0, 1, 2]]
[[components]]
name = "sheet"
open = true
[[components.patches]]
degree_u = 1
degree_v = 1
{line}
"#
    );
    let files = Files::from([("setup.toml".to_owned(), text.into_bytes())]);
    read_setup(&files, None, &Limits::default()).expect_err("must be refused").to_string()
}

#[test]
fn the_unspoilt_set_up_is_accepted() {
    let content = read(&document()).expect("is valid");
    assert_eq!(content.name, "box and ball");
    assert_eq!(content.files, ["setup.json"]);
    assert_eq!(content.input.components.len(), 2);
    assert_eq!(content.input.mesh.cells.len(), 7);
    assert_eq!(content.input.parameterisation.variables().len(), 1);
    assert_eq!(content.input.options.protected_groups, ["corner"]);
    let points = content.input.parameterisation.control_points(&[0.5]).expect("acceptable");
    assert_eq!(points[1][0], [0.5, 0.0, 0.0]);
}

#[test]
fn nan_and_infinite_control_points() {
    let spoil = |number: &str| {
        let text = document().to_string().replacen("[1.0,1.0,0.0]", &format!("[1.0,{number},0.0]"), 2);
        let files = Files::from([("setup.json".to_owned(), text.into_bytes())]);
        read_setup(&files, None, &Limits::default()).expect_err("must be refused").to_string()
    };
    // The first face with this corner.
    let field = "components[1].patches[0].control_points[1][1][1]";
    assert_eq!(spoil("NaN"), format!("{field} = NaN is not finite"));
    assert_eq!(spoil("-Infinity"), format!("{field} = -inf is not finite"));
    assert_eq!(spoil("1e999"), format!("{field} = inf is not finite"));
    assert_eq!(
        toml_with(
            "knots_u = [0, 0, 1, 1]\nknots_v = [0, 0, 1, 1]\n\
             control_points = [[[0, 0, 0], [0, 1, 0]], [[1, 0, nan], [1, 1, 0]]]"
        ),
        "components[0].patches[0].control_points[1][0][2] = NaN is not finite"
    );
    assert_eq!(
        toml_with(
            "knots_u = [0, 0, inf, 1]\nknots_v = [0, 0, 1, 1]\n\
             control_points = [[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]]"
        ),
        "components[0].patches[0].knots_u[2] = inf is not finite"
    );
}

#[test]
fn nan_in_a_geometry_file_is_told_by_component() {
    let mut document = document();
    document["components"][1] = json!({ "name": "box", "file": "geometry/box.json" });
    let geometry = json!({ "patches": common::cube() }).to_string();
    let spoilt = geometry.replacen("\"knots_u\":[0.0,0.0,1.0,1.0]", "\"knots_u\":[0.0,0.0,1.0,NaN]", 1);
    assert_ne!(geometry, spoilt);
    let mut files = files(&document);
    files.insert("geometry/box.json".into(), spoilt.into_bytes());
    let error = read_setup(&files, None, &Limits::default()).expect_err("must be refused");
    assert_eq!(error.to_string(), "components[1].patches[0].knots_u[3] = NaN is not finite");
    files.insert("geometry/box.json".into(), geometry.into_bytes());
    let content = read_setup(&files, None, &Limits::default()).expect("is valid");
    assert_eq!(content.files, ["setup.json", "geometry/box.json"]);
}

#[test]
fn knots_that_are_none() {
    let at = "/components/1/patches/2/knots_v";
    assert_eq!(
        refused_with(at, json!([0.0, 1.0, 0.5, 1.0])),
        "components[1].patches[2].knots_v[2] = 0.5 is smaller than the 1 before it; knots must not decrease"
    );
    assert!(refused_with(at, json!([])).starts_with("components[1].patches[2].knots_v: 0 knots are too few"));
    assert!(
        refused_with(at, json!([0.0, 0.0, 0.0, 0.0]))
            .starts_with("components[1].patches[2].knots_v: the domain")
    );
    let torn = refused_with(at, json!([0.0, 0.0, 0.5, 0.5, 1.0, 1.0]));
    assert!(torn.starts_with("components[1].patches[2].knots_v: the interior knot 0.5"), "{torn}");
    assert_eq!(
        refused_with("/components/1/patches/0/degree_u", json!(10)),
        "components[1].patches[0].degree_u = 10 is outside 1..=9"
    );
    assert!(
        refused_with("/components/1/patches/0/degree_u", json!(-1))
            .contains("components[1].patches[0].degree_u")
    );
}

#[test]
fn sizes_that_do_not_match() {
    let points = "/components/1/patches/3/control_points";
    let p = [0.0, 0.0, 0.0];
    assert_eq!(
        refused_with(points, json!([[p, p]])),
        "components[1].patches[3].control_points has 1 rows, expected 2 (knots_u less degree_u + 1)"
    );
    assert_eq!(
        refused_with(points, json!([[p, p], [p, p, p]])),
        "components[1].patches[3].control_points[1] has 3 points, expected 2 (knots_v less degree_v + 1)"
    );
    let mut d = document();
    d["components"][1]["patches"][3]["weights"] = json!([[1.0, 1.0], [1.0]]);
    assert_eq!(
        refused(&d),
        "components[1].patches[3].weights[1] has 1 weights, expected 2 (knots_v less degree_v + 1)"
    );
    d["components"][1]["patches"][3]["weights"] = json!([[1.0, 1.0], [0.0, 1.0]]);
    assert_eq!(refused(&d), "components[1].patches[3].weights[1][0] = 0 must be positive");
    let flat = refused_with(points, json!([[[0.0, 0.0], p], [p, p]]));
    assert!(flat.starts_with("setup.json: components[1].patches[3].control_points[0][0]"), "{flat}");
}

#[test]
fn empty_and_huge_counts() {
    assert_eq!(refused_with("/components", json!([])), "components has 0 entries, expected at least one");
    assert_eq!(
        refused_with("/components/1/patches", json!([])),
        "components[1].patches has 0 patches, expected at least one"
    );
    assert_eq!(refused_with("/mesh/cells", json!([])), "mesh: the mesh has no cells");
    let mut d = document();
    d["mesh"]["vertices"] = json!([]);
    d["mesh"]["cells"] = json!([]);
    assert_eq!(refused(&d), "mesh: the mesh has no vertices");
    let mut d = document();
    d["parameterisation"]["variables"][0]["shape"] = json!([1_000_000_000_000_u64]);
    assert!(
        refused(&d).starts_with("parameterisation.variables[0].shape[0] = 1000000000000 is outside 1..=")
    );

    let limits = Limits { components: 1, ..Limits::default() };
    let error = read_setup(&files(&document()), None, &limits).expect_err("too many");
    assert_eq!(error.to_string(), "components: 2 components exceed the limit of 1");
    let limits = Limits { control_points: 10, ..Limits::default() };
    let error = read_setup(&files(&document()), None, &limits).expect_err("too many");
    assert_eq!(
        error.to_string(),
        "components[1].patches[2]: 12 control points up to here exceed the limit of 10"
    );
    let mesh = moldline_mesh::Limits { vertices: 7, ..moldline_mesh::Limits::default() };
    let error =
        read_setup(&files(&document()), None, &Limits { mesh, ..Limits::default() }).expect_err("too many");
    assert!(error.to_string().starts_with("mesh: 8 vertices are more than the limit of 7"), "{error}");
}

#[test]
fn cells_with_vertices_out_of_range_or_repeated() {
    assert_eq!(refused_with("/mesh/cells/3/2", json!(99120)), "mesh: cells[3][2] = 99120 is outside 0..8");
    assert_eq!(
        refused_with("/mesh/cells/1/3", json!(4_294_967_295_u32)),
        "mesh.cells[1][3] = 4294967295 is no vertex"
    );
    let repeated = refused_with("/mesh/cells/3/2", json!(1));
    assert!(
        repeated.starts_with("mesh: cells[3] = [1, 3, 1, 5] names vertex 1 more than once"),
        "{repeated}"
    );
    assert_eq!(refused_with("/mesh/cells/5", json!([1, 2])), "mesh.cells[5] has 2 vertices, expected 3 or 4");
    let text = refused_with("/mesh/cells/5/0", json!(-1));
    assert!(text.starts_with("setup.json: mesh.cells[5][0]: invalid value: integer `-1`"), "{text}");
    let text = refused_with("/mesh/vertex_groups/0/indices", json!([7, 8]));
    assert!(text.contains("`corner`") && text.contains("= 8 is outside 0..8"), "{text}");
}

#[test]
fn mesh_files() {
    let mut d = document();
    d["mesh"] = json!({ "file": "mesh.msh" });
    assert_eq!(refused(&d), "mesh.file = 'mesh.msh' is not among the files of the set-up: setup.json");
    d["mesh"] = json!({ "file": "mesh.cgns" });
    let mut with_mesh = files(&d);
    with_mesh.insert("mesh.cgns".into(), vec![]);
    let error = read_setup(&with_mesh, None, &Limits::default()).expect_err("unknown ending");
    assert_eq!(error.to_string(), "mesh.file = 'mesh.cgns' must end in .msh, .vtu or .stl");
    d["mesh"] = json!({ "file": "mesh.msh" });
    let mut with_mesh = files(&d);
    with_mesh.insert("mesh.msh".into(), b"$MeshFormat\n4.1 0 8\n".to_vec());
    let error = read_setup(&with_mesh, None, &Limits::default()).expect_err("cut off");
    assert!(error.to_string().starts_with("mesh (mesh.msh): line "), "{error}");
    d["mesh"] = json!({});
    assert_eq!(refused(&d), "mesh needs exactly one of file and (vertices with cells); found none");
    d["mesh"] = json!({ "file": "mesh.msh", "merge_tolerance": -0.1 });
    with_mesh.insert("setup.json".into(), d.to_string().into_bytes());
    let error = read_setup(&with_mesh, None, &Limits::default()).expect_err("meaningless");
    assert_eq!(error.to_string(), "mesh.merge_tolerance = -0.1 must be 0 or greater");
}

#[test]
fn unknown_and_missing_fields() {
    let mut d = document();
    d["options"]["trainig_vertices"] = json!(100);
    let text = refused(&d);
    assert!(
        text.starts_with("setup.json: options.trainig_vertices: unknown field `trainig_vertices`"),
        "{text}"
    );
    let mut d = document();
    d["components"][1]["patches"][0].as_object_mut().expect("is an object").remove("degree_v");
    let text = refused(&d);
    assert!(text.starts_with("setup.json: components[1].patches[0]: missing field `degree_v`"), "{text}");
    let mut d = document();
    d["parameterisation"]["operations"][0]["axis"] = json!([0.0, 1.0, 0.0]);
    let text = refused(&d);
    assert!(text.starts_with("setup.json: parameterisation.operations[0]"), "{text}");
    assert!(text.contains("unknown field `axis`"), "{text}");
    assert_eq!(
        refused_with("/format", json!(2)),
        "format = 2 is not supported; this program reads format = 1"
    );
    let text = refused_with("/parameterisation/variables/0/unit", json!("furlong"));
    assert!(
        text.starts_with("setup.json: parameterisation.variables[0].unit: unknown variant `furlong`"),
        "{text}"
    );
    let text = toml_with("weight = [1]");
    assert!(
        text.starts_with("setup.toml: components[0].patches[0].weight: unknown field `weight`"),
        "{text}"
    );
}

#[test]
fn broken_documents() {
    let with = |name: &str, bytes: &[u8]| {
        let files = Files::from([(name.to_owned(), bytes.to_vec())]);
        read_setup(&files, None, &Limits::default()).expect_err("must be refused").to_string()
    };
    let cut_off = with("setup.json", b"{\"format\": 1,");
    assert!(cut_off.starts_with("setup.json: ") && cut_off.contains("EOF while parsing"), "{cut_off}");
    assert!(with("setup.toml", b"format = = 1").starts_with("setup.toml: TOML parse error at line 1"));
    assert_eq!(with("setup.toml", b"name = '\xff'"), "setup.toml: is not UTF-8 from byte 8");
    let trailing = format!("{} {{}}", document());
    assert!(with("setup.json", trailing.as_bytes()).starts_with("setup.json: trailing characters"));
    let deep = "[".repeat(100_000);
    assert!(with("setup.json", format!("{{\"mesh\": {deep}").as_bytes()).starts_with("setup.json: "));
    let deep = format!("mesh = {deep}");
    assert!(with("setup.toml", deep.as_bytes()).starts_with("setup.toml: "));
    assert!(
        with("readme.txt", b"")
            .starts_with("there is no set-up file; expected one of setup.toml and setup.json")
    );
    let mut two = files(&document());
    two.insert("setup.toml".into(), vec![]);
    let error = read_setup(&two, None, &Limits::default()).expect_err("which one?");
    assert!(error.to_string().starts_with("there are two set-up files"), "{error}");
    // Naming one helps.
    assert!(read_setup(&two, Some("setup.json"), &Limits::default()).is_ok());
    let error = read_setup(&two, Some("other.json"), &Limits::default()).expect_err("not there");
    assert!(error.to_string().starts_with("setup_file = 'other.json' is not among the files"), "{error}");
}

#[test]
fn components() {
    assert_eq!(refused_with("/components/1/name", json!("ball")), "components[1].name: 'ball' occurs twice");
    assert_eq!(refused_with("/components/1/name", json!("")), "components[1].name = '' must not be empty");
    let mut d = document();
    d["components"][0]["patches"] = json!([]);
    assert_eq!(
        refused(&d),
        "components[0] needs exactly one of file, patches and primitive; found patches, primitive"
    );
    let text = refused_with("/components/0/primitive/radius", json!(-1.0));
    assert!(text.starts_with("components[0].primitive ('ball'): the primitive's radius is -1"), "{text}");
    // Without one side the box is open.
    let mut d = document();
    d["components"][1]["patches"].as_array_mut().expect("is a list").pop();
    let text = refused(&d);
    assert!(text.starts_with("components[1] ('box'): side "), "{text}");
    d["components"][1]["open"] = json!(true);
    assert!(read(&d).is_ok());
    let mut d = document();
    d["components"][1]["edge_tolerance"] = json!(2.0);
    assert_eq!(refused(&d), "components[1].edge_tolerance = 2 is outside 0..=0.1");
}

#[test]
fn parameterisations() {
    assert_eq!(
        refused_with("/parameterisation/operations/0/variable", json!("dz")),
        "parameterisation.operations[0].variable = 'dz' does not exist; there are: dx"
    );
    assert_eq!(
        refused_with("/parameterisation/operations/0/components/0", json!("wing")),
        "parameterisation.operations[0].components[0] = 'wing' does not exist; there are: ball, box"
    );
    assert_eq!(
        refused_with("/parameterisation/variables/0/lower", json!(0.5)),
        "parameterisation.variables[0] 'dx': baseline 0 is outside its bounds 0.5..1 m"
    );
}

#[test]
fn paths_that_leave_the_folder() {
    let with = |path: &str| {
        let mut d = document();
        d["components"][1] = json!({ "name": "box", "file": path });
        refused(&d)
    };
    for path in
        ["../box.json", "/etc/passwd", "a/../../b.json", "C:/box.json", "a\\b.json", "a//b.json", "", "a\0b"]
    {
        let text = with(path);
        assert!(text.starts_with("components[1].file: path '"), "{path}: {text}");
    }
    assert!(with(&"x".repeat(1000)).contains("is too long"));
}

#[test]
fn names_have_a_length() {
    let long = "n".repeat(257);
    for (pointer, field) in [
        ("/name", "name"),
        ("/components/0/name", "components[0].name"),
        ("/mesh/vertex_groups/0/name", "mesh.vertex_groups[0].name"),
    ] {
        let mut spoilt = document();
        *spoilt.pointer_mut(pointer).expect(pointer) = json!(long);
        let error = refused(&spoilt);
        assert!(error.starts_with(field) && error.contains("257 bytes"), "{error}");
        assert!(error.len() < 200, "{error}");
    }
}

#[test]
fn toml_has_a_size() {
    let error = toml_with(&"# a long remark\n".repeat(1 << 20));
    assert!(error.contains("bytes of TOML"), "{error}");
}
