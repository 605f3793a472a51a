//! The report as one HTML page.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Result;
use decouplegs::render::Image;
use decouplegs::scene::episode::PlannerRecord;
use decouplegs::scene::{Episode, Lane};

use super::{
    DeviceUse, Scored, birds_eye, charts, commanded, rows, rules, score, share, spread, summary,
    timing,
};
use crate::arguments::quoted;
use crate::lidar::previews::{ABOVE, RANGES};
use crate::page::{Figure, Page, Table, escaped};
use crate::sites::Sites;
use crate::thumbnail::thumbnail;

/// Episodes that are shown; a page of hundreds would not be read.
const SHOWN_MAX: usize = 24;
/// Recorded road users that are named where they were handed over.
const HANDED_OVER_SHOWN: usize = 8;
/// Largest width of an image of the strip, pixels.
const STRIP_WIDTH_PX: u32 = 240;

pub fn page(
    scored: &[Scored],
    sites: &Sites,
    devices: Option<&DeviceUse>,
    out: &Path,
) -> Result<String> {
    let planners = scored
        .iter()
        .map(|scored| scored.head.planner.name.as_str());
    let planners: BTreeSet<&str> = planners.collect();
    let planners: Vec<&str> = planners.into_iter().collect();
    let mut page = Page::new(&format!("{} in closed loop", planners.join(", ")));
    page.text(&facts(scored));
    let agents = commanded::text(scored);
    if !agents.is_empty() {
        page.text(&agents);
    }
    table(&mut page, scored)?;
    rules::part(&mut page, scored);
    timing::part(&mut page, scored);
    if let Some(devices) = devices {
        devices.part(&mut page, scored);
    }
    episodes(&mut page, scored, sites, out)?;
    Ok(page.finish())
}

/// Sentence on what `planner` was told.
fn seen(planner: &PlannerRecord) -> String {
    match (planner.cameras.is_empty(), planner.privileged) {
        (true, true) => {
            "It received the states of all vehicles, which no camera shows, and needed no images."
                .to_owned()
        }
        (_, true) => "It received the states of all vehicles, which no camera shows.".to_owned(),
        (true, false) => "It saw nothing.".to_owned(),
        (false, false) if planner.localization => {
            "It was told nothing but its own motion, its pose and its route.".to_owned()
        }
        (false, false) => "It was told nothing but its own motion and its navigation.".to_owned(),
    }
}

fn facts(scored: &[Scored]) -> String {
    let Some(first) = scored.first() else {
        return "No episodes.".into();
    };
    let planner = &first.head.planner;
    let planners = scored.iter().map(|scored| &scored.head.planner);
    let told: BTreeMap<&str, String> = planners
        .map(|planner| (planner.name.as_str(), seen(planner)))
        .collect();
    let sees = match told.len() {
        1 => seen(planner),
        _ => {
            let told = told.iter().map(|(name, told)| format!("{name}: {told}"));
            told.collect::<Vec<_>>().join(" ")
        }
    };
    let drawn = first
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
    format!("{sees} {drawn}")
}

fn table(page: &mut Page, scored: &[Scored]) -> Result<()> {
    page.heading("Scores");
    let mut table = Table::new([
        "level",
        "episodes",
        "DS",
        "SR",
        "RC",
        "minTTC, s",
        "on course",
        "TTC < 1.5 s",
        "collisions",
        "at fault",
        "unavoidable",
        "pedestrians",
        "static",
        "off-road",
        "wrong way",
        "red light",
        "stop sign",
    ]);
    for (level, set) in rows(&summary(scored)?) {
        table.row([
            level.to_string(),
            set.count().to_string(),
            score(&set.driving_score),
            share(&set.success),
            score(&set.route_completion),
            spread(set.min_ttc_s.as_ref(), 2),
            set.min_ttc_s.map_or(0, |moments| moments.count).to_string(),
            format!("{:.1} %", 100.0 * set.ttc_short_share.mean),
            set.collisions.to_string(),
            set.collisions_at_fault.to_string(),
            set.unavoidable_collisions.to_string(),
            set.pedestrian_collisions.to_string(),
            set.obstacle_collisions.to_string(),
            set.layout_infractions.to_string(),
            set.wrong_ways.to_string(),
            set.red_lights.to_string(),
            set.stop_signs.to_string(),
        ]);
    }
    page.table(&table);
    page.note(
        "Mean over episodes and its 95 % confidence interval. RC, route completion: share of the route that was driven. DS, driving score: \
         RC times 0.60 for a collision at fault, 0.65 for one with something static, 0.65 for each time the ego left the road, 0.50 for \
         more than 2 m within a second against the direction of the lane and 0 for more than 6 m (as in nuPlan), 0.70 for \
         each red light that it ran, 0.80 for each stop sign that it passed without standing, and 0.50 instead of 0.60 for a pedestrian. \
         A collision that was not the ego's fault takes nothing: the route counts as completed in DS. Unavoidable: braking with 8 m/s^2 along its \
         way would not have helped the ego at any moment at which it would touch the other within 2.5 s at the velocities of that moment. PDMS of an episode is NAVSIM's \
         formula, taken from what was driven. SR, success rate: share of episodes that came to the end of the route without any of them, so SR <= RC. minTTC: \
         least time until the boxes of the ego and an agent would touch if both kept their velocities, within 10 s, over the episodes that \
         were on course for a collision at all, whose number is beside it.",
    );
    Ok(())
}

/// Failures first, the worst of them at the top.
fn by_failure(a: &Scored, b: &Scored) -> Ordering {
    let key = |scored: &Scored| (scored.score.success, !scored.at_fault());
    key(a)
        .cmp(&key(b))
        .then(a.score.driving_score.total_cmp(&b.score.driving_score))
        .then(a.name().cmp(b.name()))
}

fn episodes(page: &mut Page, scored: &[Scored], sites: &Sites, out: &Path) -> Result<()> {
    let mut order: Vec<&Scored> = scored.iter().collect();
    order.sort_by(|a, b| by_failure(a, b));
    page.heading("Episodes, failures first");
    if order.len() > SHOWN_MAX {
        page.text(&format!(
            "{SHOWN_MAX} of {}; report.json has all.",
            order.len()
        ));
    }
    if !order.is_empty() {
        page.note(
            "'decouplegs view' shows an episode in the browser, from the time that is given. Its commands here are for the folder in which \
             this page was written; a click selects one whole.",
        );
    }
    for scored in order.into_iter().take(SHOWN_MAX) {
        card(page, scored, &lanes(scored, sites, out))?;
    }
    Ok(())
}

/// The lanes of an episode's place; none where its map is not at hand.
fn lanes(scored: &Scored, sites: &Sites, out: &Path) -> Vec<Lane> {
    sites.lanes(&scored.place(), out).unwrap_or_default()
}

fn card(page: &mut Page, scored: &Scored, lanes: &[Lane]) -> Result<()> {
    let episode = scored.whole()?;
    page.subheading(&format!("{}: {}", scored.name(), scored.ending()));
    page.text(&scored.explained());
    page.text(&scored.pdm_explained());
    page.text(&rules::extended_pdm_explained(&scored.extended_pdm));
    page.text(&rules::explained(scored));
    if let Some(sentence) = handed_over(&episode) {
        page.text(&sentence);
    }
    if let Some(lost) = scored.time_lost() {
        page.text(&lost);
    }
    let score = &scored.score;
    let time_s = scored.way.last();
    page.html(&format!(
        "<p>{}, {:.1} s, at most {:.1} m/s² of braking and {:.1} m/s² sideways; {}, {}</p>",
        score
            .min_ttc_s()
            .map_or("never on a collision course".into(), |ttc_s| format!(
                "minTTC {ttc_s:.2} s"
            )),
        time_s.map_or(0.0, |point| point.time_s),
        score.comfort.braking_max_mps2,
        score.comfort.lateral_acceleration_max_mps2,
        link(&format!("logs/{}.log", scored.scenario_name()), "log"),
        link(
            &format!("scenarios/{}.toml", scored.scenario_name()),
            "scenario"
        ),
    ));
    page.html(&format!("<p>{}</p>", view_command(scored, None)));
    for warning in scored.seen.warnings() {
        page.note(&format!("Warning: {warning}."));
    }
    infractions(page, scored);
    let above = Figure::flexible_svg(&birds_eye::svg(scored, &episode, lanes));
    page.row(std::iter::once(above).chain(charts::figures(scored, &episode)));
    key_images(page, scored)?;
    if let Some(lidar) = scored.head.planner.lidars.first() {
        sweeps(page, scored, lidar)?;
    }
    for camera in &scored.head.planner.cameras {
        let file = format!("{camera}.mp4");
        if scored.images.join(&file).exists() {
            let path = format!("images/{}/{file}", scored.name());
            let link = link(&path, &format!("film of camera {camera}"));
            page.html(&format!("<p>{link}</p>"));
        }
    }
    Ok(())
}

/// Images of the first camera over the episode, each with its time.
/// Sentence on recorded road users that were handed over to the driver model; `None` where none
/// follow tracks.
fn handed_over(episode: &Episode) -> Option<String> {
    let scenario = &episode.head.scenario;
    let count = scenario.story.tracks.agents.len();
    let handed: Vec<_> = episode
        .steps
        .iter()
        .flat_map(|step| &step.handovers)
        .collect();
    let first = handed.iter().take(HANDED_OVER_SHOWN);
    let named = first.map(|one| format!("{} at {:.1} s", scenario.agent(one.agent).0, one.time_s));
    let named: Vec<String> = named.collect();
    let more = match handed.len().saturating_sub(HANDED_OVER_SHOWN) {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    (count > 0).then(|| match named.is_empty() {
        true => format!("All {count} recorded road users followed their tracks."),
        false => format!(
            "Handed over to the driver model: {} of {count} recorded road users: {}{more}.",
            handed.len(),
            named.join(", ")
        ),
    })
}

fn key_images(page: &mut Page, scored: &Scored) -> Result<()> {
    page.strip(timed_images(scored, "key_", ".png")?);
    Ok(())
}

/// Sweeps of a LiDAR over the episode: from above, and ranges by column and row.
fn sweeps(page: &mut Page, scored: &Scored, lidar: &str) -> Result<()> {
    for (kind, of) in [
        (ABOVE, "from above, the ego in the middle, ahead at the top"),
        (RANGES, "ranges by column and row"),
    ] {
        let figures = timed_images(scored, "sweep_", &format!(".{kind}.png"))?;
        if !figures.is_empty() {
            page.note(&format!("LiDAR {lidar}, {of}"));
            page.strip(figures);
        }
    }
    Ok(())
}

/// Images of an episode whose names have this start and this end, each with its time.
fn timed_images(scored: &Scored, start: &str, end: &str) -> Result<Vec<Figure>> {
    let figure = |path: PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let step = step_of(&name, end).unwrap_or(0);
        let time_s = f64::from(step) * scored.head.scenario.step_s;
        let image = thumbnail(&Image::read(&path)?, STRIP_WIDTH_PX);
        Figure::image(&format!("{time_s:.1} s"), &image)
    };
    let paths = files(&scored.images, start, end);
    paths.into_iter().map(figure).collect()
}

/// HTML of a link to a file beside the page.
fn link(path: &str, text: &str) -> String {
    format!("<a href=\"{}\">{}</a>", escaped(path), escaped(text))
}

/// The command that shows an episode in the viewer, from `time_s` on, as HTML.
fn view_command(scored: &Scored, time_s: Option<f64>) -> String {
    let log = scored.log.display().to_string();
    // The viewer takes what begins with a dash for an option.
    let log = if log.starts_with('-') {
        format!("./{log}")
    } else {
        log
    };
    let mut command = format!("decouplegs view {}", quoted(&log));
    if let Some(time_s) = time_s {
        let time_s = (1e6 * time_s).round() / 1e6;
        command.push_str(&format!(" --time {time_s}"));
    }
    format!("<code class=\"command\">{}</code>", escaped(&command))
}

/// Step in the name of an image, before its end.
fn step_of(name: &str, end: &str) -> Option<u32> {
    let number = name.strip_suffix(end)?.rsplit('_').next()?;
    number.parse().ok()
}

/// Table of the infractions: time, kind, place of the ego, and the last image before it.
fn infractions(page: &mut Page, scored: &Scored) {
    if scored.score.infractions.is_empty() {
        return;
    }
    let mut table = Table::new([
        "time, s",
        "infraction",
        "factor",
        "ego at x, m",
        "y, m",
        "image",
        "in the viewer",
    ])
    .with_text_in(1)
    .with_text_in(6);
    for infraction in &scored.score.infractions {
        let at_m = scored.place_m(infraction.time_s);
        let image = image_before(scored, infraction.time_s).map_or("-".into(), |file| {
            let path = format!("images/{}/{file}", scored.name());
            link(&path, &path)
        });
        let what = escaped(&infraction.describe(&scored.head));
        table.row_of_html(
            false,
            [
                format!("{:.1}", infraction.time_s),
                what,
                format!("{:.2}", infraction.factor()),
                format!("{:.1}", at_m.x),
                format!("{:.1}", at_m.y),
                image,
                view_command(scored, Some(infraction.time_s)),
            ],
        );
    }
    page.table(&table);
}

/// Name of the last image in the folder of an episode that was taken before a time.
fn image_before(scored: &Scored, time_s: f64) -> Option<String> {
    let step = (time_s / scored.head.scenario.step_s + 1e-9) as u32;
    let files = std::fs::read_dir(&scored.images).ok()?.flatten();
    let images = files.filter_map(|file| {
        let name = file.file_name().into_string().ok()?;
        let number = step_of(&name, ".png")?;
        (number <= step).then_some((number, name))
    });
    images.max().map(|(_, name)| name)
}

/// Files in `folder` whose names have this start and this end, by name.
fn files(folder: &Path, start: &str, end: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    let is_wanted = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(start) && name.ends_with(end)
    };
    let mut wanted: Vec<_> = entries.filter(is_wanted).collect();
    wanted.sort();
    wanted
}
