//! What the names of an orientation's columns show about its convention, and what they do not.

use super::column::SeenColumn;
use super::names::words;

/// Keys of a map.
pub(super) struct Turned {
    /// With the reason.
    pub keys: Vec<(&'static str, &'static str, String)>,
    /// With what is to be decided.
    pub open: Vec<(&'static str, &'static str, String)>,
}

/// What can be said about these columns; `None` if they are not an orientation that a map can name.
pub(super) fn turned(columns: &[&SeenColumn]) -> Option<Turned> {
    let name = |column: &&SeenColumn| words(column.said_name()).last().cloned().unwrap_or_default();
    let names: Vec<String> = columns.iter().map(name).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let by_name = |form: &'static str, order: &'static str| Turned {
        keys: vec![("form", form, "by the names".to_owned()), ("order", order, "by the names".to_owned())],
        open: Vec::new(),
    };
    let form = |form: &'static str, key: &'static str, value: &'static str, why: &str| Turned {
        keys: vec![("form", form, "by the number of columns and their names".to_owned())],
        open: vec![(key, value, why.to_owned())],
    };
    let open = |value: &'static str, why: &str| Turned {
        keys: Vec::new(),
        open: vec![("form", value, why.to_owned())],
    };
    const SEQUENCE: &str = "about which axes, in the order of the columns, and whether each is about the axes as the turns before left them \
                            (intrinsic) or about axes that stay (fixed)";
    Some(match names.as_slice() {
        ["qw", "qx", "qy", "qz"] | ["w", "x", "y", "z"] => by_name("quaternion", "wxyz"),
        ["qx", "qy", "qz", "qw"] | ["x", "y", "z", "w"] => by_name("quaternion", "xyzw"),
        ["q1", "q2", "q3", "q4"] => {
            form("quaternion", "order", "wxyz", "ABB's q1 is the scalar; if q4 is, \"xyzw\"")
        }
        [_, _, _, _] => form("quaternion", "order", "wxyz", "if the last column is the scalar, \"xyzw\""),
        ["a", "b", "c"] => open(
            "kuka_abc",
            "KUKA's A, B, C are about z, the new y and the new x; other makers use these names too: then \"euler\" with a \
             sequence",
        ),
        ["w", "p", "r"] => open("fanuc_wpr", "FANUC's W, P, R are about the fixed x, y and z"),
        ["o", "a", "t"] => open("kawasaki_oat", "Kawasaki's O, A, T are about z, the new y and the new z"),
        ["rx", "ry", "rz"] => open(
            "ur_rotation_vector",
            "UR's is a rotation vector; Staubli's are angles about x, the new y and the new z: \"staubli_rxryrz\"; others are \"euler\" with a sequence",
        ),
        ["yaw", "pitch", "roll"] => form("euler", "sequence", "zyx intrinsic", SEQUENCE),
        [_, _, _] => form("euler", "sequence", "xyz fixed", SEQUENCE),
        ["r11", .., "r33"] | ["m11", .., "m33"] => by_name("matrix", "rows"),
        // Normal, orientation and approach are the columns of a matrix.
        ["nx", .., "az"] => by_name("matrix", "columns"),
        nine if nine.len() == 9 => {
            form("matrix", "order", "rows", "whether the first three are the first row, or the first column")
        }
        _ => return None,
    })
}
