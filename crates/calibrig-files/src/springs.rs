//! Springs in six directions, as tables of files have them.

/// Declares a table of a file with the six stiffnesses of a spring, each optional, and further fields.
///
/// A macro, because a `serde(flatten)`ed struct knows neither the places of its keys nor which of them are unknown.
#[macro_export]
macro_rules! spring_table {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($(#[$of_field:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$meta])*
        #[derive(serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        $vis struct $name {
            stiffness_x_n_per_m: Option<$crate::Spanned<f64>>,
            stiffness_y_n_per_m: Option<$crate::Spanned<f64>>,
            stiffness_z_n_per_m: Option<$crate::Spanned<f64>>,
            stiffness_rx_nm_per_rad: Option<$crate::Spanned<f64>>,
            stiffness_ry_nm_per_rad: Option<$crate::Spanned<f64>>,
            stiffness_rz_nm_per_rad: Option<$crate::Spanned<f64>>,
            $($(#[$of_field])* $field: $type,)*
        }

        impl $name {
            /// Along x, y and z, N/m, and about them, N m/rad, each with its key.
            fn stiffnesses(&self) -> [(&'static str, &Option<$crate::Spanned<f64>>); 6] {
                [
                    ("stiffness_x_n_per_m", &self.stiffness_x_n_per_m),
                    ("stiffness_y_n_per_m", &self.stiffness_y_n_per_m),
                    ("stiffness_z_n_per_m", &self.stiffness_z_n_per_m),
                    ("stiffness_rx_nm_per_rad", &self.stiffness_rx_nm_per_rad),
                    ("stiffness_ry_nm_per_rad", &self.stiffness_ry_nm_per_rad),
                    ("stiffness_rz_nm_per_rad", &self.stiffness_rz_nm_per_rad),
                ]
            }
        }
    };
}
