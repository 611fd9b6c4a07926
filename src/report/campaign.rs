//! The page of a campaign.

use crate::montecarlo::{CampaignSummary, summary_text};

/// The page.
pub fn campaign_html(summary: &CampaignSummary) -> String {
    format!("<pre>{}</pre>", summary_text(summary))
}
