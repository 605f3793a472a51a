//! The lane-changing model MOBIL (A. Kesting, M. Treiber, D. Helbing: General lane-changing model
//! MOBIL for car-following models, Transportation Research Record 1999, 2007), with safety,
//! politeness to both followers, a threshold and a bias to the right.

/// A driver's parameters in the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MobilParameters {
    /// Politeness p, the weight of the gain of others: 0 is selfish, 1 is altruistic; 0 to 0.5 is
    /// usual.
    pub politeness: f64,
    /// Changing threshold, m/s^2: 0.2. It keeps drivers from changing for nothing.
    pub threshold_mps2: f64,
    /// The follower on the new lane must not have to brake harder, m/s^2: 4.
    pub safe_braking_mps2: f64,
    /// Added to the gain of changes to the right and taken from those to the left, m/s^2: 0.2 where
    /// one is to keep right.
    pub right_bias_mps2: f64,
}

impl Default for MobilParameters {
    /// Treiber's, without a bias: in towns all lanes are alike.
    fn default() -> Self {
        Self {
            politeness: 0.25,
            threshold_mps2: 0.2,
            safe_braking_mps2: 4.0,
            right_bias_mps2: 0.0,
        }
    }
}

/// Acceleration of a vehicle without the change and with it, m/s^2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Change {
    /// Acceleration without a change of lanes.
    pub before_mps2: f64,
    /// Acceleration right after the change.
    pub after_mps2: f64,
}

impl Change {
    fn gain(&self) -> f64 {
        self.after_mps2 - self.before_mps2
    }
}

/// Vehicles affected by a lane change. A vehicle that is not there gains nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Concerned {
    /// Vehicle that changes lanes.
    pub oneself: Change,
    /// Follower on the new lane.
    pub new_follower: Change,
    /// Follower on the old lane.
    pub old_follower: Change,
}

/// Direction of a change of lanes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Change to the left.
    Left,
    /// Change to the right.
    Right,
}

impl MobilParameters {
    /// Gain of the change beyond its threshold, m/s^2; `None` if it is not safe.
    #[must_use]
    pub fn incentive(&self, concerned: &Concerned, side: Side) -> Option<f64> {
        if concerned.new_follower.after_mps2 < -self.safe_braking_mps2 {
            return None;
        }
        let others = concerned.new_follower.gain() + concerned.old_follower.gain();
        let bias = if side == Side::Right {
            self.right_bias_mps2
        } else {
            -self.right_bias_mps2
        };
        Some(concerned.oneself.gain() + self.politeness * others + bias - self.threshold_mps2)
    }

    /// True if the lane change should be made.
    #[must_use]
    pub fn changes(&self, concerned: &Concerned, side: Side) -> bool {
        self.incentive(concerned, side)
            .is_some_and(|incentive| incentive > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(before_mps2: f64, after_mps2: f64) -> Change {
        Change {
            before_mps2,
            after_mps2,
        }
    }

    #[test]
    fn each_term_changes_a_decision() {
        let mobil = MobilParameters {
            politeness: 0.5,
            threshold_mps2: 0.2,
            safe_braking_mps2: 4.0,
            right_bias_mps2: 0.3,
        };
        let scene = Concerned {
            oneself: change(0.0, 1.0),
            new_follower: change(0.5, -0.5),
            old_follower: change(0.0, 0.0),
        };
        // 1 - 0.5 + 0.3 - 0.2, and 0.6 less to the left.
        assert!((mobil.incentive(&scene, Side::Right).unwrap() - 0.6).abs() < 1e-12);
        assert!(mobil.changes(&scene, Side::Right));
        let without_bias = MobilParameters {
            right_bias_mps2: 0.0,
            ..mobil
        };
        let left = |mobil: MobilParameters, scene: Concerned| mobil.changes(&scene, Side::Left);
        let small = Concerned {
            oneself: change(0.0, 0.8),
            ..scene
        };
        assert!(
            left(without_bias, small) && !left(mobil, small),
            "the bias keeps to the right"
        );
        let content = Concerned {
            oneself: change(0.0, 0.65),
            ..scene
        };
        assert!(!left(without_bias, content), "the threshold");
        assert!(left(
            MobilParameters {
                threshold_mps2: 0.1,
                ..without_bias
            },
            content
        ));
        let thanked = Concerned {
            old_follower: change(-1.0, 0.0),
            ..content
        };
        assert!(
            left(without_bias, thanked),
            "the follower left behind gains"
        );
        let hindered = Concerned {
            new_follower: change(0.5, -1.5),
            ..small
        };
        assert!(!left(without_bias, hindered), "the new follower loses");
        assert!(
            left(
                MobilParameters {
                    politeness: 0.0,
                    ..without_bias
                },
                hindered
            ),
            "which the selfish do not mind"
        );
        let unsafe_gain = Concerned {
            oneself: change(-8.0, 8.0),
            new_follower: change(0.0, -4.1),
            ..scene
        };
        assert_eq!(
            mobil.incentive(&unsafe_gain, Side::Left),
            None,
            "no gain is worth a crash"
        );
    }
}
