//! Constitutive laws behind one trait, [`Hyperelastic`]: [`linear`] elasticity, St. Venant–Kirchhoff
//! ([`stvk`]), stable [`neo_hookean`], [`mooney_rivlin`] and [`corotational`] elasticity.
//!
//! All are isotropic, without stress at rest, and agree with linear elasticity of the same Young's modulus
//! and Poisson's ratio for small strains: linear modes, frequencies and their updates are the
//! same for all. They part in the third derivative of the energy, from which modal derivatives come
//! ([`AtRest`]), and in all that follows of large deformation.
//!
//! Laws take the displacement gradient D = ∇u = F − I rather than F, so that small strains keep their
//! digits.

mod at_rest;
pub mod corotational;
mod cross;
pub mod linear;
pub mod mooney_rivlin;
pub mod neo_hookean;
pub mod stvk;
#[cfg(test)]
mod tests;

pub use at_rest::AtRest;
use corotational::Corotational;
use linear::Linear;
use mooney_rivlin::MooneyRivlin;
use neo_hookean::NeoHookean;
use stvk::StVenantKirchhoff;

/// A 3×3 matrix.
pub type Mat3 = nalgebra::Matrix3<f64>;

/// A 9×9 matrix over the entries of 3×3 ones (index 3·row + column), by rows.
pub type Mat9 = [[f64; 9]; 9];

/// A hyperelastic material: an energy density Ψ and its derivatives with respect to F, as functions of
/// D = F − I.
pub trait Hyperelastic {
    /// Ψ in J/m³, 0 at rest.
    fn energy_density(&self, d: &Mat3) -> f64;

    /// First Piola–Kirchhoff stress P = ∂Ψ/∂F in Pa.
    fn stress(&self, d: &Mat3) -> Mat3;

    /// ∂P/∂F in Pa.
    fn stress_derivative(&self, d: &Mat3) -> Mat9;

    /// Energy density and stress, and its derivative into `derivative`, if given: one call where they have work in
    /// common.
    fn at(&self, d: &Mat3, derivative: Option<&mut Mat9>) -> (f64, Mat3) {
        if let Some(derivative) = derivative {
            *derivative = self.stress_derivative(d);
        }
        (self.energy_density(d), self.stress(d))
    }

    /// The first and second derivative of P at rest.
    fn at_rest(&self) -> AtRest;
}

/// Which law a material follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Law {
    /// Small-strain linear elasticity: for small rotations only.
    Linear = 0,
    /// St. Venant–Kirchhoff.
    StVenantKirchhoff = 1,
    /// Stable neo-Hookean (Smith, De Goes and Kim 2018).
    NeoHookean = 2,
    /// Mooney–Rivlin, compressible.
    MooneyRivlin = 3,
    /// Corotational linear elasticity.
    Corotational = 4,
}

impl Law {
    /// Every law, in the order of their numbers.
    pub const ALL: [Law; 5] = [
        Law::Linear,
        Law::StVenantKirchhoff,
        Law::NeoHookean,
        Law::MooneyRivlin,
        Law::Corotational,
    ];
}

/// C₀₁/(C₁₀ + C₀₁) of a Mooney–Rivlin material that does not say.
pub const DEFAULT_MOONEY_RATIO: f64 = 0.2;

/// A law with its constants: what is left of a [`Material`] at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elasticity {
    /// The law.
    pub law: Law,
    /// Lamé's constants `[lame_lambda, lame_mu]` in Pa.
    pub lame: [f64; 2],
    /// C₀₁/(C₁₀ + C₀₁), of Mooney–Rivlin materials only.
    pub mooney_ratio: f64,
}

impl Elasticity {
    /// St. Venant–Kirchhoff with Lamé's constants in Pa.
    pub fn stvk(lame: [f64; 2]) -> Elasticity {
        Elasticity { law: Law::StVenantKirchhoff, lame, mooney_ratio: 0.0 }
    }

    /// The same law, `factor` times as stiff: energies are linear in the constants.
    pub(crate) fn scaled(&self, factor: f64) -> Elasticity {
        Elasticity { lame: self.lame.map(|x| x * factor), ..*self }
    }

    /// Calls `f` with the law itself.
    #[inline(always)]
    fn with<R>(&self, f: impl FnOnce(&dyn Hyperelastic) -> R) -> R {
        let lame = self.lame;
        match self.law {
            Law::Linear => f(&Linear { lame }),
            Law::StVenantKirchhoff => f(&StVenantKirchhoff { lame }),
            Law::NeoHookean => f(&NeoHookean::new(lame)),
            Law::MooneyRivlin => f(&MooneyRivlin::new(lame, self.mooney_ratio)),
            Law::Corotational => f(&Corotational { lame }),
        }
    }
}

impl Hyperelastic for Elasticity {
    fn energy_density(&self, d: &Mat3) -> f64 {
        self.with(|law| law.energy_density(d))
    }
    fn stress(&self, d: &Mat3) -> Mat3 {
        self.with(|law| law.stress(d))
    }
    fn stress_derivative(&self, d: &Mat3) -> Mat9 {
        self.with(|law| law.stress_derivative(d))
    }
    fn at(&self, d: &Mat3, derivative: Option<&mut Mat9>) -> (f64, Mat3) {
        self.with(|law| law.at(d, derivative))
    }
    fn at_rest(&self) -> AtRest {
        self.with(|law| law.at_rest())
    }
}

/// A material: a law, elastic constants and density, validated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    law: Law,
    young_modulus_pa: f64,
    poisson_ratio: f64,
    density_kg_m3: f64,
    mooney_ratio: f64,
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
    #[error("mooney_ratio must lie between 0 and 1, not {0}")]
    MooneyRatio(f64),
    #[error(
        "a Mooney-Rivlin material of mooney_ratio {mooney_ratio} and poisson_ratio {poisson_ratio} would not resist a change of volume"
    )]
    NoBulk { mooney_ratio: f64, poisson_ratio: f64 },
}

impl Material {
    /// E in Pa, ν, density in kg/m³.
    pub fn new(
        law: Law,
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
        let mooney_ratio = DEFAULT_MOONEY_RATIO;
        Material { law, young_modulus_pa, poisson_ratio, density_kg_m3, mooney_ratio }
            .with_mooney_ratio(mooney_ratio)
    }

    /// St. Venant–Kirchhoff: E in Pa, ν, density in kg/m³.
    pub fn stvk(
        young_modulus_pa: f64,
        poisson_ratio: f64,
        density_kg_m3: f64,
    ) -> Result<Material, MaterialError> {
        Material::new(Law::StVenantKirchhoff, young_modulus_pa, poisson_ratio, density_kg_m3)
    }

    /// The same with C₀₁/(C₁₀ + C₀₁) = `mooney_ratio`; of no effect but for Mooney–Rivlin materials.
    pub fn with_mooney_ratio(self, mooney_ratio: f64) -> Result<Material, MaterialError> {
        if !(0.0..=1.0).contains(&mooney_ratio) {
            return Err(MaterialError::MooneyRatio(mooney_ratio));
        }
        let material = Material { mooney_ratio, ..self };
        let bulk = MooneyRivlin::new(material.lame(), mooney_ratio).bulk;
        if material.law == Law::MooneyRivlin && bulk <= 0.0 {
            let poisson_ratio = material.poisson_ratio;
            return Err(MaterialError::NoBulk { mooney_ratio, poisson_ratio });
        }
        Ok(material)
    }

    /// The same material, `factor` times as stiff.
    pub fn scaled(&self, factor: f64) -> Result<Material, MaterialError> {
        Material::new(
            self.law,
            self.young_modulus_pa * factor,
            self.poisson_ratio,
            self.density_kg_m3,
        )?
        .with_mooney_ratio(self.mooney_ratio)
    }

    /// The law.
    pub fn law(&self) -> Law {
        self.law
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
    /// C₀₁/(C₁₀ + C₀₁), of effect for Mooney–Rivlin materials only.
    pub fn mooney_ratio(&self) -> f64 {
        self.mooney_ratio
    }
    /// Lamé's constants `[lame_lambda, lame_mu]` in Pa.
    pub fn lame(&self) -> [f64; 2] {
        let (e, nu) = (self.young_modulus_pa, self.poisson_ratio);
        [e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))]
    }
    /// The law with its constants, `factor` times as stiff.
    pub fn elasticity(&self, factor: f64) -> Elasticity {
        let lame = self.lame().map(|x| x * factor);
        Elasticity { law: self.law, lame, mooney_ratio: self.mooney_ratio }
    }
}
