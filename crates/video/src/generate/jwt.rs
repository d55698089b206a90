//! JSON web tokens signed with HMAC SHA-256 (RFC 7515, RFC 7519; `HS256` of RFC 7518).

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use hmac::{Hmac, Mac};
use serde_json::Value;
use sha2::Sha256;

/// The token that says `claims`, signed with `secret`.
pub fn hs256(claims: &Value, secret: &[u8]) -> String {
    let part = |text: &str| URL_SAFE_NO_PAD.encode(text);
    let signed = format!("{}.{}", part(r#"{"alg":"HS256","typ":"JWT"}"#), part(&claims.to_string()));
    format!("{signed}.{}", signature(&signed, secret))
}

fn signature(signed: &str, secret: &[u8]) -> String {
    let mut mac = Hmac::<Sha256>::new_from_slice(secret).expect("HMAC takes keys of any length");
    mac.update(signed.as_bytes());
    URL_SAFE_NO_PAD.encode(mac.finalize().into_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_case_of_rfc_4231_has_its_signature() {
        let mac = URL_SAFE_NO_PAD.decode(signature("what do ya want for nothing?", b"Jefe")).expect("decodes");
        let hex: String = mac.iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(hex, "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843", "case 2");
    }

    #[test]
    fn a_whole_token_equals_the_one_known_from_jwt_io() {
        let claims = serde_json::json!({"sub": "1234567890", "name": "John Doe", "iat": 1516239022});
        let token = hs256(&claims, b"your-256-bit-secret");
        println!("{token}");
        assert_eq!(
            token,
            "eyJhbGciOiJIUzI1NiIsInR5cCI6IkpXVCJ9.\
             eyJzdWIiOiIxMjM0NTY3ODkwIiwibmFtZSI6IkpvaG4gRG9lIiwiaWF0IjoxNTE2MjM5MDIyfQ.\
             SflKxwRJSMeKKF2QT4fwpMeJf36POk6yJV_adQssw5c"
        );
    }
}
