//! Constitutive laws. One so far: St. Venant–Kirchhoff ([`stvk`]).

pub mod stvk;

/// A material: elastic constants and density, validated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    young_modulus_pa: f64,
    poisson_ratio: f64,
    density_kg_m3: f64,
}

/// Why material constants are unphysical.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum MaterialError {
    #[error("young_modulus_pa must be positive and finite, not {0:e}")]
    YoungModulus(f64),
    #[error("poisson_ratio must lie strictly between -1 and 0.5, not {0}")]
    PoissonRatio(f64),
    #[error("density_kg_m3 must be positive and finite, not {0:e}")]
    Density(f64),
}

impl Material {
    /// St. Venant–Kirchhoff: E in Pa, ν, density in kg/m³.
    pub fn stvk(
        young_modulus_pa: f64,
        poisson_ratio: f64,
        density_kg_m3: f64,
    ) -> Result<Material, MaterialError> {
        let positive = |x: f64| x > 0.0 && (1e-30..=1e30).contains(&x);
        if !positive(young_modulus_pa) {
            return Err(MaterialError::YoungModulus(young_modulus_pa));
        }
        if !(poisson_ratio > -1.0 && poisson_ratio < 0.5) {
            return Err(MaterialError::PoissonRatio(poisson_ratio));
        }
        if !positive(density_kg_m3) {
            return Err(MaterialError::Density(density_kg_m3));
        }
        Ok(Material { young_modulus_pa, poisson_ratio, density_kg_m3 })
    }

    /// The same material, `factor` times as stiff.
    pub fn scaled(&self, factor: f64) -> Result<Material, MaterialError> {
        Material::stvk(self.young_modulus_pa * factor, self.poisson_ratio, self.density_kg_m3)
    }

    /// Young's modulus in Pa.
    pub fn young_modulus_pa(&self) -> f64 {
        self.young_modulus_pa
    }
    /// Poisson's ratio.
    pub fn poisson_ratio(&self) -> f64 {
        self.poisson_ratio
    }
    /// Density in kg/m³.
    pub fn density_kg_m3(&self) -> f64 {
        self.density_kg_m3
    }
    /// Lamé's constants `(lame_lambda, lame_mu)` in Pa.
    pub fn lame(&self) -> (f64, f64) {
        let (e, nu) = (self.young_modulus_pa, self.poisson_ratio);
        (e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu)))
    }
}
