mod closed_form;
mod columns;
mod equilibrium;
mod robots;
mod soft;
mod spray_painter;
mod states;
