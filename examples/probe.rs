use supple::config::Config;
use supple::policy::{shipped, Buffers};
use supple::task::Curriculum;
use supple::train::environment::LocomotionEnv;
fn main() {
    let config = Config::load("commanded").unwrap();
    let agent = shipped::find(&std::env::args().nth(1).unwrap()).unwrap();
    let inference = agent.inference();
    let mut buffers = Buffers::default();
    for fraction in [0.0, 0.25, 0.5, 1.0] {
        let (mut sum, mut steps, mut falls, mut episodes) = (0.0, 0, 0, 0);
        for index in 0..40 {
            let curriculum = Curriculum { force_fraction: fraction, ..Curriculum::complete() };
            let mut env = LocomotionEnv::new(&config, 0, index, curriculum).unwrap();
            env.reset(curriculum).unwrap();
            let mut seen = vec![0.0; env.layout().length()];
            loop {
                env.normalised_observation(&mut seen);
                let (actions, _) = inference.act(&seen, &mut buffers);
                let (step, report) = env.step(&actions.map(|x| x as f32));
                if let Some(report) = report {
                    sum += report.terms.linear_velocity();
                    steps += report.steps;
                    episodes += 1;
                    falls += usize::from(step.end == Some(supple::train::environment::End::Fall));
                    break;
                }
            }
        }
        println!("{fraction}: r_lin {:.3} falls {falls} of {episodes}", sum / steps as f64);
    }
}
