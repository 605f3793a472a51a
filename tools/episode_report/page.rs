//! The report as one HTML page that needs nothing beside it.

use std::cmp::Ordering;
use std::fmt::Write;
use std::path::Path;

use anyhow::Result;
use decouplegs::render::Image;
use decouplegs::scene::Lane;
use decouplegs::scene::scenario::Place;

use super::{Scored, birds_eye, charts, rows, score, share, spread, summary, timing};
use crate::lidar::previews::{ABOVE, RANGES};
use crate::plot::escaped;
use crate::sites::Sites;
use crate::{data_uri, plot};

/// Episodes that are shown; a page of hundreds would not be read.
const SHOWN_MAX: usize = 24;
/// Images of the strip are at most so wide, pixels.
const STRIP_WIDTH_PX: u32 = 240;

pub fn page(scored: &[Scored], sites: &Sites, out: &Path) -> Result<String> {
    let planner = scored
        .first()
        .map_or("", |scored| scored.episode.head.planner.name.as_str());
    let mut html = plot::page_start(&format!("{} in closed loop", escaped(planner)));
    html.push_str(&facts(scored));
    html.push_str(&table(scored)?);
    html.push_str(&timing::table(scored));
    html.push_str(&episodes(scored, sites, out)?);
    html.push_str("</html>\n");
    Ok(html)
}

fn facts(scored: &[Scored]) -> String {
    let Some(first) = scored.first() else {
        return "<p>No episodes.</p>".into();
    };
    let planner = &first.episode.head.planner;
    let sees = match (planner.cameras.is_empty(), planner.privileged) {
        (true, true) => {
            "It received the states of all vehicles, which no camera shows, and needed no images."
                .to_owned()
        }
        (_, true) => "It received the states of all vehicles, which no camera shows.".to_owned(),
        (true, false) => "It saw nothing.".to_owned(),
        (false, false) => "It was told nothing but its own motion and its navigation.".to_owned(),
    };
    let drawn =
        first
            .episode
            .head
            .drawn_by
            .as_ref()
            .map_or("Nothing was drawn.".to_owned(), |by| {
                let cameras = match planner.cameras.is_empty() {
                    true => String::new(),
                    false => format!(
                        "Cameras {} at {}x{}, ",
                        planner.cameras.join(", "),
                        by.width_px,
                        by.height_px
                    ),
                };
                let lidars = match planner.lidars.is_empty() {
                    true => String::new(),
                    false => format!("LiDARs {}, ", planner.lidars.join(", ")),
                };
                format!(
                    "{cameras}{lidars}every {} steps, on {}.",
                    by.every, by.device
                )
            });
    format!("<p>{} {}</p>", escaped(&sees), escaped(&drawn))
}

fn table(scored: &[Scored]) -> Result<String> {
    let mut html = String::from(
        "<h2>Scores</h2><div class=\"wide\"><table><tr><th>level<th>episodes<th>DS<th>SR<th>RC<th>minTTC, s<th>on course<th>TTC &lt; 1.5 s<th>collisions\
         <th>at fault<th>pedestrians<th>static<th>off-road<th>red light<th>stop sign",
    );
    for (level, set) in rows(&summary(scored)?) {
        let _ = write!(
            html,
            "<tr><td>{level}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{:.1} %<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}",
            set.count(),
            score(&set.driving_score),
            share(&set.success),
            score(&set.route_completion),
            spread(set.min_ttc_s.as_ref(), 2),
            set.min_ttc_s.map_or(0, |moments| moments.count),
            100.0 * set.ttc_short_share.mean,
            set.collisions,
            set.collisions_at_fault,
            set.pedestrian_collisions,
            set.obstacle_collisions,
            set.layout_infractions,
            set.red_lights,
            set.stop_signs,
        );
    }
    html.push_str(
        "</table></div><p class=\"dim\">Mean over episodes and its 95 % confidence interval. RC, route completion: share of the route that was \
         driven. DS, driving score: RC times 0.60 for a collision at fault, 0.65 for one with something static, 0.65 for each time the ego \
         left the road, 0.70 for each red light that it ran, 0.80 for each stop sign that it passed without standing, and 0.50 instead of 0.60 for a pedestrian. SR, success rate: share of episodes that came to the end of the route without any of them, so SR &lt;= RC and DS &lt;= RC. minTTC: least time until the boxes of the ego and an agent would touch if both kept their \
         velocities, within 10 s, over the episodes that were on course for a collision at all, whose number is beside it.</p>",
    );
    Ok(html)
}

/// Failures first, the worst of them at the top.
fn by_failure(a: &Scored, b: &Scored) -> Ordering {
    let key = |scored: &Scored| (scored.score.success, !scored.at_fault());
    key(a)
        .cmp(&key(b))
        .then(a.score.driving_score.total_cmp(&b.score.driving_score))
        .then(a.name().cmp(b.name()))
}

fn episodes(scored: &[Scored], sites: &Sites, out: &Path) -> Result<String> {
    let mut order: Vec<&Scored> = scored.iter().collect();
    order.sort_by(|a, b| by_failure(a, b));
    let mut html = String::from("<h2>Episodes, failures first</h2>");
    if order.len() > SHOWN_MAX {
        let _ = write!(
            html,
            "<p>{SHOWN_MAX} of {}; report.json has all.</p>",
            order.len()
        );
    }
    for scored in order.into_iter().take(SHOWN_MAX) {
        html.push_str(&card(scored, &lanes(scored, sites, out))?);
    }
    Ok(html)
}

/// The lanes of an episode's place; none where its map is not at hand.
fn lanes(scored: &Scored, sites: &Sites, out: &Path) -> Vec<Lane> {
    let place = match &scored.episode.head.scenario.place {
        // Where nothing is drawn, all weathers and sizes have the same lanes.
        Place::Street { weather, seed, .. } => Place::Street {
            weather: *weather,
            background: 0,
            agent_splats: 0,
            seed: *seed,
        },
        place => place.clone(),
    };
    sites.lanes(&place, out).unwrap_or_default()
}

fn card(scored: &Scored, lanes: &[Lane]) -> Result<String> {
    let score = &scored.score;
    let mut html = format!(
        "<h3>{}: {}</h3><p>{}</p><p>{}, {:.1} s, at most {:.1} m/s² of braking and {:.1} m/s² sideways; <a href=\"{}\">log</a>, \
         <a href=\"{}\">scenario</a></p>{}<div class=\"row\"><figure style=\"flex:1 1 24em\">{}</figure>{}",
        escaped(scored.name()),
        escaped(&scored.ending()),
        escaped(&scored.explained()),
        score
            .min_ttc_s()
            .map_or("never on a collision course".into(), |ttc_s| format!(
                "minTTC {ttc_s:.2} s"
            )),
        scored
            .episode
            .instants()
            .last()
            .map_or(0.0, |instant| instant.time_s),
        score.comfort.braking_max_mps2,
        score.comfort.lateral_acceleration_max_mps2,
        escaped(&format!("logs/{}.log", scored.name())),
        escaped(&format!("scenarios/{}.toml", scored.name())),
        infractions(scored),
        birds_eye::svg(scored, lanes),
        charts::figures(scored)
    );
    html.push_str("</div>");
    html.push_str(&strip(scored)?);
    Ok(html)
}

/// Images of the first camera over the episode, each with its time, and links to its films.
fn strip(scored: &Scored) -> Result<String> {
    let mut html = String::new();
    for path in files(&scored.images, "key_", ".png") {
        let image = data_uri::shrunk(&Image::read(&path)?, STRIP_WIDTH_PX);
        let step = step_of(&path.file_name().unwrap_or_default().to_string_lossy());
        let time_s = f64::from(step.unwrap_or(0)) * scored.episode.head.scenario.step_s;
        let _ = write!(
            html,
            "<figure style=\"flex:none;margin:0\"><img src=\"{}\" alt=\"after {time_s:.1} s\"><figcaption>{time_s:.1} s</figcaption></figure>",
            data_uri::png(&image)?,
        );
    }
    if !html.is_empty() {
        html = format!("<div class=\"wide\" style=\"display:flex;gap:4px\">{html}</div>");
    }
    if let Some(lidar) = scored.episode.head.planner.lidars.first() {
        html.push_str(&sweeps(scored, lidar)?);
    }
    for camera in &scored.episode.head.planner.cameras {
        let file = format!("{camera}.mp4");
        if scored.images.join(&file).exists() {
            let link = escaped(&format!("images/{}/{file}", scored.name()));
            let _ = write!(
                html,
                "<p><a href=\"{link}\">film of camera {}</a></p>",
                escaped(camera)
            );
        }
    }
    Ok(html)
}

/// Sweeps of a LiDAR over the episode: from above, and ranges by column and row.
fn sweeps(scored: &Scored, lidar: &str) -> Result<String> {
    let caption = |of: &str| format!("LiDAR {}, {of}", escaped(lidar));
    let rows = [
        (
            ABOVE,
            caption("from above, the ego in the middle, ahead at the top"),
        ),
        (RANGES, caption("ranges by column and row")),
    ];
    let mut html = String::new();
    for (kind, caption) in rows {
        let mut figures = String::new();
        for path in files(&scored.images, "sweep_", &format!(".{kind}.png")) {
            let image = data_uri::shrunk(&Image::read(&path)?, STRIP_WIDTH_PX);
            let _ = write!(
                figures,
                "<img src=\"{}\" alt=\"{caption}\">",
                data_uri::png(&image)?
            );
        }
        if !figures.is_empty() {
            let _ = write!(
                html,
                "<figure style=\"margin:0\"><div class=\"wide\" style=\"display:flex;gap:4px\">{figures}</div><figcaption>{caption}</figcaption></figure>"
            );
        }
    }
    Ok(html)
}

/// Step in the name of an image.
fn step_of(name: &str) -> Option<u32> {
    let number = name.strip_suffix(".png")?.rsplit('_').next()?;
    number.parse().ok()
}

/// Table of the infractions: time, kind, place of the ego, and the last image before it.
fn infractions(scored: &Scored) -> String {
    if scored.score.infractions.is_empty() {
        return String::new();
    }
    let mut html = String::from(
        "<div class=\"wide\"><table><tr><th>time, s<th>infraction<th>factor<th>ego at x, m<th>y, m<th>image",
    );
    for infraction in &scored.score.infractions {
        let at_m = scored.place_m(infraction.time_s);
        let image = image_before(scored, infraction.time_s).map_or("-".into(), |file| {
            let file = format!("images/{}/{file}", scored.name());
            format!("<a href=\"{0}\">{0}</a>", escaped(&file))
        });
        let _ = write!(
            html,
            "<tr><td>{:.1}<td>{}<td>{:.2}<td>{:.1}<td>{:.1}<td>{image}",
            infraction.time_s,
            escaped(&infraction.describe(&scored.episode.head)),
            infraction.factor(),
            at_m.x,
            at_m.y
        );
    }
    html.push_str("</table></div>");
    html
}

/// Name of the last image in the folder of an episode that was taken before a time.
fn image_before(scored: &Scored, time_s: f64) -> Option<String> {
    let step = (time_s / scored.episode.head.scenario.step_s + 1e-9) as u32;
    let files = std::fs::read_dir(&scored.images).ok()?.flatten();
    let images = files.filter_map(|file| {
        let name = file.file_name().into_string().ok()?;
        let number = step_of(&name)?;
        (number <= step).then_some((number, name))
    });
    images.max().map(|(_, name)| name)
}

/// Files in `folder` whose names have this start and this end, by name.
fn files(folder: &Path, start: &str, end: &str) -> Vec<std::path::PathBuf> {
    let entries = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    let is_wanted = |path: &std::path::PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(start) && name.ends_with(end)
    };
    let mut wanted: Vec<_> = entries.filter(is_wanted).collect();
    wanted.sort();
    wanted
}
