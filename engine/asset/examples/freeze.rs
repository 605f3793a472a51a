use decouplegs_asset::episode_log::encode;
use decouplegs_scene::episode::*;
use decouplegs_scene::*;
use glam::DVec2;
fn main() {
    let scenario = decouplegs_asset::scenario_file::parse("version = 1\nname = \"small\"\nlevel = \"easy\"\nseed = \"0xfedcba9876543210\"\nduration_s = 1.5\n[place.street]\nweather = \"dusk\"\nbackground = 1000\nagent_splats = 100\nseed = 7\n[ego]\nroute = [\"right\"]\nstart_m = 5.0\nend_m = 60.0\nspeed_mps = 8.0\ncruise_mps = 11.0\n[[agent]]\nname = \"taxi\"\nasset = 3\nlane = \"left\"\nat_m = 25.0\nspeed_mps = 9.0\n[[agent.behaviour]]\nmaneuver = \"brake\"\nnear_ego_m = 14.0\ndeceleration_mps2 = 7.0\nduration_s = 0.1\n").unwrap();
    let state = |x: f64| VehicleState { position_m: DVec2::new(x, 0.1), speed_mps: 8.0, ..VehicleState::default() };
    let instant = |time_s: f64| Instant { time_s, ego: state(8.0 * time_s), steer_rad: 0.01, on_road: time_s < 1.0, agents: vec![state(20.0 + time_s / 3.0)] };
    let step = |step: u32| EpisodeStep {
        step,
        images: vec![ImageRecord { camera: "front".into(), hash: 7 << 100 | u128::from(step) }],
        plan: Plan::new(vec![PlanPoint { time_s: 0.5, position_m: DVec2::new(4.0, -0.0) }]).unwrap(),
        instants: vec![instant(0.5 * f64::from(step) + 0.25), instant(0.5 * f64::from(step) + 0.5)],
    };
    let head = EpisodeHead {
        version: "0.1.0".into(),
        agent_sizes: vec![VehicleSize::CAR],
        scenario,
        planner: PlannerRecord { name: "lane-follow".into(), cameras: vec!["front".into()], privileged: true },
        drawn_by: Some(DrawnBy { device: "a device".into(), width_px: 64, height_px: 36, every: 1 }),
        route_m: vec![DVec2::ZERO, DVec2::new(100.0, 1.0 / 3.0)],
    };
    let episode = Episode { head, start: instant(0.0), steps: (0..3).map(step).collect(), end: EpisodeEnd::Collision { agent: 0 } };
    std::fs::write("/tmp/small.log", encode(&episode).unwrap()).unwrap();
}
