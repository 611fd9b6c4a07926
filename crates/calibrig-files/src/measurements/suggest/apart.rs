//! Joints in one file and points in others: which is which, if no header says so.

use super::SeenFile;
use super::column::{Role, SeenColumn};

/// No axis turns further than two turns, in degrees.
const MOST_ANGLE: f64 = 720.0;

/// Gives files that were read separately their common roles.
pub(super) fn see_together(files: &mut [SeenFile]) {
    if files.len() < 2 {
        return;
    }
    let has_points = |file: &SeenFile| {
        [Role::X, Role::Range].iter().any(|role| file.one(*role).is_some())
            && file.with(Role::Joint).is_empty()
    };
    // A controller's log has its own position next to the joints: the points are in the other files.
    if files.iter().any(has_points) {
        for file in files.iter_mut().filter(|file| file.has_header && !file.with(Role::Joint).is_empty()) {
            if file.one(Role::X).is_some_and(|x| x.doubt.is_some()) {
                drop_position(file);
            }
        }
    }
    let bare: Vec<usize> = (0..files.len())
        .filter(|index| {
            !files[*index].has_header && !files[*index].is_bag && looks_like_angles(&files[*index])
        })
        .collect();
    // Three numbers per row are a point, unless those of all others are lengths by their size.
    let is_wide = |index: &usize| numbers(&files[*index]).count() != 3;
    let wide: Vec<usize> = bare.iter().copied().filter(is_wide).collect();
    let [joints] = (if wide.is_empty() { &bare } else { &wide }).as_slice() else { return };
    let others_are_points = (0..files.len()).all(|index| index == *joints || has_points(&files[index]));
    let are_lengths = |file: &SeenFile| numbers(file).any(|column| column.numbers.largest() > MOST_ANGLE);
    let is_told =
        !wide.is_empty() || (0..files.len()).all(|index| index == *joints || are_lengths(&files[index]));
    if others_are_points && is_told {
        take_all_as_joints(&mut files[*joints]);
    }
}

/// Columns that are neither names nor counters.
fn numbers(file: &SeenFile) -> impl Iterator<Item = &SeenColumn> {
    file.columns.iter().filter(|column| {
        column.is_number() && matches!(column.role, Some(Role::Joint | Role::X | Role::Y | Role::Z))
    })
}

/// Whether all numbers can be angles, except for one that may slide; points have at least two larger lengths, or only three numbers.
fn looks_like_angles(file: &SeenFile) -> bool {
    let long = numbers(file).filter(|column| column.numbers.largest() > MOST_ANGLE).count();
    let count = numbers(file).count();
    count >= 2 && if count > 3 { long <= 1 } else { long == 0 }
}

fn take_all_as_joints(file: &mut SeenFile) {
    let taken = file.columns.iter_mut().filter(|column| {
        column.is_number() && matches!(column.role, Some(Role::Joint | Role::X | Role::Y | Role::Z))
    });
    for (order, column) in taken.enumerate() {
        column.take(
            Role::Joint,
            order,
            "the numbers could be angles, and the points are in the other files; check it",
        );
    }
}

fn drop_position(file: &mut SeenFile) {
    for column in &mut file.columns {
        if matches!(column.role, Some(Role::X | Role::Y | Role::Z)) {
            (column.role, column.doubt) = (None, None);
        }
    }
}
